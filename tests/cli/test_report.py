"""`pearl report`: what is on the page is what is in the files, and what is there is kept."""

from __future__ import annotations

import csv
import html.parser
import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from pearl_marl.benchmark.measure import Contender
from pearl_marl.benchmark.steps import contenders
from pearl_marl.benchmark.tables import BATCH, ENVPOOL, KERNEL
from pearl_marl.cli import app
from pearl_marl.envs import get_spec, names
from pearl_marl.errors import ArgumentError, DeviceError
from pearl_marl.experiments import energy, figure6, figure7, figure8, goals, report
from pearl_marl.experiments.section import KINDS, Row, select


class Page(html.parser.HTMLParser):
    """The rows of every section's table: each cell its text, and the number behind it if it has one."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.sections: dict[str, list[list[tuple[str, str | None]]]] = {}
        self.links: list[str] = []
        self._section = ""
        self._text, self._number = "", None
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        if tag == "section":
            self._section = given["id"] or ""
            self.sections[self._section] = []
        elif tag == "tr" and self._section:
            self.sections[self._section].append([])
        elif tag in ("td", "th"):
            self._text, self._number = "", given.get("data-number")
        self.links += [given[key] or "" for key in ("href", "src") if key in given]

    def handle_data(self, data: str) -> None:
        self._text += data

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th") and self._section:
            self.sections[self._section][-1].append((self._text, self._number))


def number(text: str) -> float:
    value, _, prefix = text.replace(",", "").partition(" ")
    return float(value) * {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}[prefix]


def check(folder: Path, name: str, page: Page) -> dict[str, Any]:
    """Hold the page against a section's data file; return what the file has."""
    data: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    assert data["machine"]["processor"]
    assert data["machine"]["versions"]["pearl-marl"]
    seeds = {row["seed"] for row in data["rows"] if row.get("seed") is not None}
    assert data["seeds"] == (sorted(seeds) or [0])
    assert data["date"] > "2020-01-01T00:00:00+00:00"
    columns = report.load(name).COLUMNS
    heading, *table = page.sections[name]
    keys = ["kind", *(key for key in columns if any(row.get(key) is not None for row in data["rows"]))]
    assert [text for text, _ in heading] == ["kind", *(columns[key] for key in keys[1:])]
    assert len(table) == len(data["rows"])
    for row, cells in zip(data["rows"], table, strict=True):
        assert row["kind"] in KINDS
        for key, (text, behind) in zip(keys, cells, strict=True):
            value = row.get(key)
            if isinstance(value, bool):
                assert text == ("yes" if value else "no")
            elif isinstance(value, (int, float)):
                assert float(behind or "nan") == value
                assert number(text) == pytest.approx(value, rel=1e-3)
            else:
                assert text == (value or "")
    with (folder / f"{name}.csv").open(newline="") as file:
        assert [row["kind"] for row in csv.DictReader(file)] == [row["kind"] for row in data["rows"]]
    return data


@pytest.mark.slow
@pytest.mark.parametrize(
    "but",
    [
        ("trainings", "worlds", "equations", "figure6", "figure7", "figure9", "population"),
        pytest.param((), marks=pytest.mark.exhaustive),
    ],
    ids=["most", "all"],
)
def test_quick(
    tmp_path: Path, recwarn: pytest.WarningsRecorder, monkeypatch: pytest.MonkeyPatch, but: tuple[str, ...]
) -> None:
    """Every section has its files, and the page their numbers."""
    # Each training is a process of its own; the benchmark's tests have those, and the trainers' tests learn
    # in worlds. Nor are cores synthesised: the commands of docs/synthesis.md do that. Simulated devices are
    # measured by the tests of `pearl bench` and of latencies.
    monkeypatch.setattr(report, "SECTIONS", [name for name in report.SECTIONS if name not in but])
    if but:  # two of the games that are learned in seconds do as well as four
        few = [goal for goal in goals.goals() if goal.env_id in ("CliffWalking", "Blackjack")]
        monkeypatch.setattr(goals, "goals", lambda: few)
    result = CliRunner().invoke(app, ["report", "--quick", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert not [w for w in recwarn if "precision lowered" in str(w.message)], "of EnvPool's spaces"
    page = Page((tmp_path / "index.html").read_text())
    rows = {name: check(tmp_path, name, page)["rows"] for name in report.SECTIONS}
    for link in page.links:
        assert (tmp_path / link).exists() if not link.startswith("#") else link[1:] in report.SECTIONS
    pictures = (
        "figure3",
        "equations",
        "figure6",
        "figure7",
        "figure8",
        "figure9",
        "goals",
        "trainings",
        "worlds",
        "population",
    )
    for name in {*pictures} & {*report.SECTIONS}:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000

    bits = {
        (row["environment"], row["quantity"]): row for row in rows["figure3"] if row["kind"] == "measured"
    }
    assert bits["CliffWalking", "action"]["bits_after"] == 2
    assert bits["Seaquest", "observation"]["bits_before"] == 8000, "bools of 8 bits"
    assert all(row["reached"] for row in rows["goals"])
    (blackjack,) = select(rows["goals"], environment="Blackjack")
    optimum = blackjack["wanted"] + 0.02
    assert abs(blackjack["mean_return"] - optimum) < 3 * blackjack["ci95"], "nobody beats the optimal policy"
    if but:
        return
    kinds = {row["contender"]: row["kind"] for row in rows["figure6"] if row.get("steps_per_second")}
    assert kinds[BATCH] == "measured"
    assert kinds[figure6.SIMULATED] == "simulated"
    assert kinds[figure6.BOARD] == "predicted"
    assert kinds[figure6.SIMULATED_SERIAL] == "simulated"
    assert kinds[figure6.BOARD_SERIAL] == "predicted"
    assert kinds["the paper: EnvPool"] == "quoted"
    assert all(row["over_no_pipeline"] > 1 for row in rows["figure6"] if row["contender"] == figure6.BOARD)
    cycles = {
        (row["what"], row["kind"]): row["cycles"] for row in rows["equations"] if row.get("pe_num") == 4
    }
    assert cycles["a step", "simulated"] == cycles["a step", "predicted"]
    assert cycles["over AXI", "simulated"] == cycles["over AXI", "predicted"]
    assert {row["kind"] for row in rows["figure9"]} == {"predicted", "quoted"}
    summaries = {row["contender"]: row for row in rows["figure7"] if row.get("what") == "median of 1"}
    assert summaries[figure7.BATCHED]["reached"]
    assert all(summaries[name]["common_seconds"] > 0 for name in figure7.SOURCES)
    assert select(rows["population"], part="alone")[-1]["reached"] == 1


def test_without_torch_the_rest_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [
        name
        for name in sys.modules
        if name.startswith(("pearl_marl.experiments.", "pearl_marl.training", "pearl_marl.policies"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    only = ["--only", "goals", "--only", "table2"]
    result = CliRunner().invoke(app, ["report", "--quick", "--out", str(tmp_path), *only])
    assert result.exit_code == 1
    assert "it needs the Python package torch: pip install '.[report]'" in result.output
    assert json.loads((tmp_path / "table2.json").read_text())["rows"]
    assert "the Python package torch" in (tmp_path / "index.html").read_text()


# ---- The machinery, with sections of no work ----


@pytest.fixture
def sections(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Two sections, ``one`` and ``two``, with what they are to do and how often they did it."""

    def section(name: str) -> Any:
        def collect(quick: bool, progress: Any) -> list[Row]:
            made.calls.append(name)
            if made.fails.get(name):
                raise made.fails[name]
            return [{"kind": "measured", "steps": 1_234_567.8, "counts": f"<{name}>"}]

        columns = {"steps": "steps/s", "counts": "what"}
        return SimpleNamespace(
            TITLE=name, TEXT="", COLUMNS=columns, SEEDS=(0,), collect=collect, draw=lambda rows: None
        )

    made: Any = SimpleNamespace(calls=[], fails={})
    modules = {name: section(name) for name in ("one", "two", "three")}
    monkeypatch.setattr(report, "SECTIONS", tuple(modules))
    monkeypatch.setattr(report, "load", modules.__getitem__)
    return made


def run(folder: Path, *arguments: str) -> Any:
    return CliRunner().invoke(app, ["report", "--out", str(folder), *arguments])


def test_a_killed_run_goes_on(sections: Any, tmp_path: Path) -> None:
    sections.fails["two"] = KeyboardInterrupt()
    run(tmp_path)
    assert sections.calls == ["one", "two"]
    sections.fails.clear()
    result = run(tmp_path)
    assert result.exit_code == 0, result.output
    assert sections.calls == ["one", "two", "two", "three"]
    assert f"delete {tmp_path / 'one.json'}" in result.stderr
    assert not list(tmp_path.glob(".*")), "nothing half-written is left"


def test_a_damaged_file_is_made_again(sections: Any, tmp_path: Path) -> None:
    run(tmp_path, "--only", "one")
    (tmp_path / "one.json").write_text('{"rows": [')
    assert "damaged; measured again" in run(tmp_path, "--only", "one").stderr
    check(tmp_path, "one", Page((tmp_path / "index.html").read_text()))


def test_a_file_of_an_older_version_is_told(sections: Any, tmp_path: Path) -> None:
    """Its rows lack what is drawn now; the rest of the page is made."""
    run(tmp_path)
    report.load("one").draw = lambda rows: rows[0]["new"]
    assert run(tmp_path).exit_code == 0
    page = (tmp_path / "index.html").read_text()
    assert f"{tmp_path / 'one.json'} has no &#39;new&#39;: an older version made it; delete it" in page
    assert len(Page(page).sections["two"]) == 2


def test_quick_never_replaces_full(sections: Any, tmp_path: Path) -> None:
    run(tmp_path, "--quick")
    assert "one.json is of a quick run; measured again" in run(tmp_path).stderr
    before = (tmp_path / "one.json").read_bytes()
    assert json.loads(before)["quick"] is False
    result = run(tmp_path, "--quick")
    assert isinstance(result.exception, ArgumentError)
    assert "one.json is of a full run" in str(result.exception)
    assert (tmp_path / "one.json").read_bytes() == before


def test_what_cannot_be_made_is_told(sections: Any, tmp_path: Path) -> None:
    """The others are made; the page and the exit status say so."""
    sections.fails["one"] = DeviceError("the program yosys is missing")
    result = run(tmp_path)
    assert result.exit_code == 1
    assert sections.calls == ["one", "two", "three"]
    assert "one: not made: the program yosys is missing" in result.stderr
    text = (tmp_path / "index.html").read_text()
    assert "Not made: the program yosys is missing" in text
    assert "&lt;two&gt;" in text
    check(tmp_path, "two", Page(text))


def test_only_some(sections: Any, tmp_path: Path) -> None:
    result = run(tmp_path, "--only", "two", "--only", "one")
    assert result.exit_code == 0
    assert sections.calls == ["one", "two"]
    assert "pearl report --only three" in (tmp_path / "index.html").read_text()


def test_refused_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = run(tmp_path, "--only", "figure7b")
    assert "there is no section 'figure7b'" in str(unknown.exception)
    assert ", ".join(report.SECTIONS) in str(unknown.exception)
    file = tmp_path / "file"
    file.write_text("")
    assert "is no folder that can be written" in str(run(file, "--only", "table2").exception)
    monkeypatch.setitem(sys.modules, "jinja2", None)
    assert "pip install '.[report]'" in str(run(tmp_path, "--only", "table2").exception)


def test_every_contender_has_its_name() -> None:
    """Figure 6 looks for contenders of `pearl bench steps` by name."""
    known = {contender.name for contender in contenders(get_spec("CliffWalking"), 7)}
    assert {KERNEL, BATCH, *figure6.PEERS, figure6.SIMULATED} <= known


def test_builds_of_figure_9_are_of_environments() -> None:
    assert set(report.load("figure9").BUILDS) <= set(names())  # type: ignore[attr-defined]


def test_figure_9_draws_all_environments() -> None:
    """Each in each panel, with a look of its own."""
    pytest.importorskip("matplotlib")
    figure9: Any = importlib.import_module("pearl_marl.experiments.figure9")
    sizes = dict.fromkeys(("lut", "ff", "bram36", "n_envs"), 9)
    rows = [
        {"kind": "predicted", "environment": name, **dict.fromkeys(figure9.COLUMNS), "n_envs": n, **more}
        for name in names()
        for n, more in (
            (16, sizes | {"environment": name}),
            (64, {"environment": name, "from_n_envs": 16, "lut_growth": 1.5, "ff_growth": 1.2}),
        )
    ]
    *panels, growth = figure9.draw(rows).axes
    for axes in panels:
        lines = axes.lines
        assert [line.get_label() for line in lines] == names()
        looks = {(line.get_color(), line.get_linestyle(), line.get_markerfacecolor()) for line in lines}
        assert len(looks) == len(names())
    assert [label.get_text() for label in growth.get_yticklabels()] == names()


def test_eq_1_is_fitted_as_it_is_drawn() -> None:
    """By its relative errors, with no time below nothing."""
    equations = importlib.import_module("pearl_marl.experiments.equations")
    x = [10.0, 100.0, 1000.0, 10_000.0]
    slope, constant = equations.fitted(x, [7 + 0.5 * value for value in x])
    assert (slope, constant) == (pytest.approx(0.5), pytest.approx(7))
    slope, constant = equations.fitted(x, [value**1.5 for value in x])
    assert slope > 0
    assert constant == 0
    assert equations.fitted([1.0, 2.0], [3.0, 1.0])[0] == 0


def test_a_run_made_again_counts_where_it_was_not_disturbed() -> None:
    points = [[(1.0, 10, 5.0), (4.0, 20, 9.0)], [(2.0, 10, 5.0), (3.0, 20, 9.0)]]
    runs = [figure7.TimedRun("SB3", 0, 4, made) for made in points]
    assert figure7.undisturbed(runs).points == [(1.0, 10, 5.0), (2.0, 20, 9.0)]
    other = figure7.TimedRun("SB3", 0, 4, [(1.5, 10, 9.0)])
    assert figure7.undisturbed([*runs, other]) is other, "the shortest, where they did not do the same"


# ---- Energy ----


def counters(folder: Path, *values: int) -> None:
    for i, value in enumerate(values):
        package = folder / f"intel-rapl:{i}"
        package.mkdir(exist_ok=True)
        (package / "energy_uj").write_text(f"{value}\n")
        (package / "max_energy_range_uj").write_text("10000000\n")


def test_energy_is_that_of_all_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of the counters starts over meanwhile."""
    monkeypatch.setattr(energy, "POWERCAP", tmp_path)
    with pytest.raises(energy.UnmeasuredError, match="no RAPL counters"):
        energy.Rapl()
    counters(tmp_path, 1_000_000, 9_500_000)
    (tmp_path / "intel-rapl:0:0").mkdir()  # a part of a package, and no package
    waited: list[bool] = []
    spent = energy.spend(
        energy.Rapl(), lambda: counters(tmp_path, 3_000_000, 500_000), lambda: waited.append(True), 0.0001
    )
    assert waited == [True]
    assert spent.joules == pytest.approx(2.0 + 1.0)
    assert spent.steps >= 1
    assert spent.seconds > 0


def test_figure_8_where_energy_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as many joules are twice the steps per joule; counters that stand still are no measurement."""
    joules = iter([1.0, 2.0, 0.0])
    meter = type("Meter", (), {"counts": "a meter", "platform": "CPU"})
    monkeypatch.setattr(figure8, "METERS", {meter: tuple(contender.name for contender in STEPPED[1:])})
    monkeypatch.setattr(energy, "spend", lambda *arguments: energy.Energy(next(joules), 0.5, 10))
    monkeypatch.setattr(figure8, "contenders", lambda spec, n: STEPPED)
    rows = figure8.collect(True, lambda items, total, label: iter(items))
    ours, envpool, sync = (row for row in rows if row.get("n_envs"))
    assert (ours["kind"], ours["steps_per_joule"], ours["watts"]) == ("measured", 10 * 100, 2.0)
    assert (ours["over_envpool"], ours["over_vector_env"]) == (2.0, None)
    assert envpool["steps_per_joule"] == 500
    assert sync["kind"] == "missing"
    assert len(figure8.draw(rows).axes) == 3


STEPPED = [
    Contender(name, "nothing", 100, lambda: lambda: None) for name in (KERNEL, BATCH, ENVPOOL, figure6.SYNC)
]


def test_counters_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(energy, "POWERCAP", tmp_path)
    counters(tmp_path, 1)
    (tmp_path / "intel-rapl:0" / "energy_uj").unlink()
    with pytest.raises(energy.UnmeasuredError, match="cannot be read: No such file"):
        energy.Rapl()


def test_energy_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a library of NVIDIA's that is played here, and which the machine of this test may not have."""
    nvml = pytest.importorskip("cuda.bindings.nvml", reason="pip install '.[cuda]'")
    millijoules = iter([5_000, 6_000, 8_500])
    monkeypatch.setattr(nvml, "init_v2", lambda: None)
    monkeypatch.setattr(nvml, "device_get_handle_by_uuid", lambda uuid: 7 if uuid.startswith("GPU-") else 8)
    monkeypatch.setattr(
        nvml, "device_get_total_energy_consumption", lambda board: next(millijoules) * (board == 7)
    )
    assert energy.spend(energy.Nvml(), lambda: None, lambda: None, 0.0001).joules == pytest.approx(2.5)
    monkeypatch.setattr(nvml, "init_v2", lambda: nvml.check_status(9))
    with pytest.raises(energy.UnmeasuredError, match="no GPU that NVML can read"):
        energy.Nvml()
