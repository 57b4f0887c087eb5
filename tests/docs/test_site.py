"""The site of the documentation (`make docs`): links lead somewhere, and a browser shows all of it."""

from __future__ import annotations

import html.parser
import http.server
import importlib.util
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]

if importlib.util.find_spec("mkdocs") is None or importlib.util.find_spec("mkdocstrings_handlers") is None:
    pytest.skip("MkDocs is not installed: pip install '.[docs]'", allow_module_level=True)


class Page(html.parser.HTMLParser):
    """What a page refers to, what it loads, and the anchors in it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        values = dict(attributes)
        self.anchors.update(values[name] for name in ("id", "name") if values.get(name))
        target = values.get("src" if tag in ("img", "script") else "href")
        if target and tag in ("img", "script", "link"):
            self.loaded.append(target)
        elif target and tag == "a":
            self.links.append(target)


@pytest.fixture(scope="module")
def site(once: Any) -> Path:
    def build(folder: Path) -> None:
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder]
        environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr

    return once("site", build)


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    # The page for paths that do not exist has links from the site's root.
    return {path: Page(path) for path in site.rglob("*.html") if path.name != "404.html"}


def test_every_page_of_the_repository_is_there(site: Path) -> None:
    for page in [*ROOT.glob("docs/*.md"), *ROOT.glob("envs/*/README.md"), *ROOT.glob("examples/*.*")]:
        path = site / page.relative_to(ROOT).with_suffix(".html")
        assert (path.with_name("index.html") if page.name == "README.md" else path).is_file(), page


def test_links_lead_somewhere(site: Path, pages: dict[Path, Page]) -> None:
    assert len(pages) > 60
    for path, page in pages.items():
        for link in (*page.links, *page.loaded):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert there.is_file(), f"{path.relative_to(site)} refers to {link}"
            if parts.fragment and there.suffix == ".html":
                anchors = pages[there].anchors
                assert unquote(parts.fragment) in anchors, f"{path.relative_to(site)} refers to {link}"


def test_nothing_is_loaded_from_elsewhere(pages: dict[Path, Page]) -> None:
    assert not [link for page in pages.values() for link in page.loaded if urlsplit(link).netloc]


def test_the_reference_tells_what_a_program_may_rely_on(pages: dict[Path, Page]) -> None:
    import pearl_marl

    told = set().union(*(page.anchors for path, page in pages.items() if path.parent.name == "reference"))
    assert {f"pearl_marl.{name}" for name in pearl_marl.__all__ if not name.startswith("_")} - told <= {
        "pearl_marl.EnvSpec"  # under pearl_marl.spec, where its author imports it from
    }
    assert {"pearl_marl.spec.EnvSpec", "pearl_marl.PearlParallelEnv.step"} <= told


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    reason = "playwright is not installed: pip install '.[browser]'"
    api = pytest.importorskip("playwright.sync_api", reason=reason)
    with api.sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        found = own if Path(own).exists() else shutil.which("chromium") or shutil.which("google-chrome")
        if found is None:
            pytest.skip("no Chromium: `playwright install chromium`, or Debian's package chromium")
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    handler = partial(Quiet, directory=site)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def opened(browser: Any, width: int) -> tuple[Any, list[str]]:
    """Return a tab of a width, and what goes wrong in it."""
    tab, wrong = browser.new_page(viewport={"width": width, "height": 844}), []
    tab.on("pageerror", lambda error: wrong.append(f"{tab.url}: {error}"))

    def failed(request: Any) -> None:
        if (
            request.failure != "net::ERR_ABORTED"
        ):  # which is what happens to a page's icon when the tab goes on
            wrong.append(f"{tab.url}: {request.url} was not loaded: {request.failure}")

    def answered(response: Any) -> None:
        if response.status >= 400:
            wrong.append(f"{tab.url}: {response.url} is answered with {response.status}")

    tab.on("requestfailed", failed)
    tab.on("response", answered)
    return tab, wrong


@pytest.mark.slow
@pytest.mark.parametrize(("width", "names"), [(390, "**/*.html"), (1280, "index.html")])
def test_a_browser_shows_the_pages(browser: Any, address: str, site: Path, width: int, names: str) -> None:
    tab, wrong = opened(browser, width)
    for path in site.glob(names):
        tab.goto(f"{address}/{path.relative_to(site)}")
        assert tab.locator("h1").first.is_visible(), tab.url
        assert tab.evaluate("document.documentElement.scrollWidth") <= width, f"{tab.url} scrolls sideways"
        unseen = "Array.from(document.images).filter(i => !i.complete || !i.naturalWidth).map(i => i.src)"
        assert tab.evaluate(unseen) == [], tab.url
    assert wrong == []
    tab.close()


def test_the_search_finds_an_environment(browser: Any, address: str) -> None:
    tab, wrong = opened(browser, 390)
    tab.goto(f"{address}/index.html")
    tab.locator("label[for=__search]").first.click()
    tab.get_by_placeholder("Search").fill("FrozenLake")
    tab.locator("a[href*='frozen_lake']").first.wait_for()
    assert wrong == []
    tab.close()
