"""The pages of the site (``make docs``): a hook of MkDocs.

A page has the path that it has in the repository, so that links lead to the same place here and on GitHub.
Source files that they link to, and notebooks, become pages. The API reference is made of docstrings.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import griffe
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]

PAGES = ("*.md", "docs/*.md", "docs/images/*", "envs/*/README.md", "rtl/README.md", "examples/*.md")
SOURCES = ("envs/*/*.py", "wrappers/observations.py", "examples/**/*.py", "examples/*.ipynb")
"""Files that pages link to, and that are shown as pages."""
ALSO = ("LICENSE", "CITATION.cff")
"""Files that pages link to, and that are delivered as they are."""

REFERENCE = {
    "Environments": (
        *(
            "parallel_env",
            "env",
            "raw_env",
            "make_vec",
            "list_envs",
            "load_policy",
            "get_spec",
            "register",
            "unpacked",
        ),
        *(
            "PearlParallelEnv",
            "PearlVectorEnv",
            "batch.step.BatchStep",
            "batch.rollout.Rollout",
            "interfaces.agent_dict.AgentDict",
        ),
        "errors",
    ),
    "Devices": ("devices", "verification"),
    "Wrappers": (
        "wrappers",
        "wrappers.stable_baselines3",
        "wrappers.rllib",
        "wrappers.torchrl",
        "wrappers.benchmarl",
    ),
    "Evaluation": ("evaluation", "policies"),
    "Hardware": ("memory_map", "latency", "hardware"),
    "Authors": ("spec", "golden", "fixed_point", "planes", "testing"),
}
"""Headings of the reference's pages, and what of ``pearl_marl`` is on them."""


class Source(File):
    """A file of the repository that is no page there."""

    def is_documentation_page(self) -> bool:
        """Return that it is one here."""
        return True


def on_config(config: Any) -> Any:
    """Put every environment's page in the place of the pattern that stands in the navigation for all."""
    pattern = "envs/*/README.md"
    for section in config.nav:
        for pages in section.values() if isinstance(section, dict) else ():
            if pattern in pages:
                at = pages.index(pattern)
                pages[at : at + 1] = sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern))
    return config


def on_files(files: Files, config: Any) -> Files:
    """Replace the files of ``docs/`` by all that the site has, at their paths in the repository."""
    theme = [file for file in files if ROOT / "docs" not in Path(file.abs_src_path or "/").parents]

    def found(patterns: tuple[str, ...]) -> list[str]:
        return sorted(str(path.relative_to(ROOT)) for pattern in patterns for path in ROOT.glob(pattern))

    return Files(
        theme
        + [File.generated(config, name, abs_src_path=str(ROOT / name)) for name in found(PAGES + ALSO)]
        + [Source.generated(config, name, content=source(name)) for name in found(SOURCES)]
        + [
            File.generated(config, f"reference/{heading.lower()}.md", content=reference(heading, names))
            for heading, names in REFERENCE.items()
        ]
    )


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Have a listing's file, which the tests of the pages read, stand above it."""
    return re.sub(r"^```(\w+) file=(\S+)$", r'```\1 title="\2"', markdown, flags=re.MULTILINE)


def source(name: str) -> str:
    """Return the page of a script or a notebook, which is not searched."""
    text = (ROOT / name).read_text()
    if not name.endswith(".ipynb"):
        return f"---\nsearch: {{exclude: true}}\n---\n# {name}\n\n```python\n{text}```\n"
    parts = []
    for cell in json.loads(text)["cells"]:
        lines = "".join(cell["source"])
        parts.append(lines if cell["cell_type"] == "markdown" else f"```python\n{lines}\n```")
        parts += [f"```text\n{''.join(output['text'])}```" for output in cell.get("outputs", [])]
    return "\n\n".join(parts) + "\n"


def reference(heading: str, names: tuple[str, ...]) -> str:
    """Return a page of the reference; mkdocstrings puts docstrings where it names things."""
    inherited = "\n    options: {inherited_members: true}"
    blocks = [f"::: pearl_marl.{name}{inherited * name.startswith('Pearl')}" for name in names]
    return "\n\n".join([f"# {heading}", *blocks]) + "\n"


class Docstrings(griffe.Extension):
    """What the reference shows of docstrings, and one name that griffe gets wrong."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Make links of Sphinx's roles."""
        if obj.docstring is None:
            return
        scope = obj if obj.is_class or obj.is_module else obj.parent

        def link(role: re.Match[str]) -> str:
            name = role[1] if role[1].startswith("pearl_marl") or scope is None else f"{scope.path}.{role[1]}"
            return f'<autoref optional identifier="{name}"><code>{role[1].split(".")[-1]}</code></autoref>'

        roles = r":(?:func|class|meth|mod|attr|data):`~?([\w.]+)`"
        obj.docstring.value = re.sub(roles, link, obj.docstring.value)

    def on_alias_instance(self, *, alias: griffe.Alias, **_: Any) -> None:
        """Take out what griffe makes of ``import pearl_marl.wrappers as wrappers``: an alias of itself."""
        if alias.target_path == alias.path and alias.parent is not None:
            del alias.parent.members[alias.name]
