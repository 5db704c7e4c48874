"""The figure files of a run."""

import json
import xml.etree.ElementTree as ET

import pytest
from matplotlib.figure import Figure

from skystack.errors import InputError
from skystack.reporting import figures
from skystack.reporting.figures import write_figures
from skystack.reporting.report import write_report
from tests.reporting.conftest import add_copy, change_row, write_run

ROWS = ["lateral-undamped-plain", "lateral-plain", "lateral-stacked", "do-nothing-lateral-plain"]
EXPECTED = {
    "loop",
    "sector",
    "routes",
    "trajectories-lateral",
    "histograms-lateral",
    "success-lateral",
    *(f"trajectory-{row}" for row in ROWS),
    *(f"histogram-{row}" for row in ROWS),
    "learning-lateral",
    "learning-lateral-undamped",
}


@pytest.mark.slow
def test_writes_every_figure_as_png_and_svg(reported):
    written = {path.name for path in (reported / "figures").iterdir()}
    assert written == {f"{name}.{kind}" for name in EXPECTED for kind in ("png", "svg")}


@pytest.mark.slow
def test_figures_are_complete_and_contain_no_local_paths(reported):
    for path in (reported / "figures").iterdir():
        data = path.read_bytes()
        assert str(reported).encode() not in data
        if path.suffix == ".svg":
            assert ET.fromstring(data).tag.endswith("svg")
        else:
            assert data.startswith(b"\x89PNG")
            assert data.endswith(b"IEND\xaeB`\x82")


@pytest.mark.slow
def test_compares_action_spaces_if_both_were_trained(tmp_path):
    rows = [("avoidance", True), ("avoidance-large", False)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=2)
    report = write_report(run).read_text()
    stems = {path.stem for path in (run / "figures").iterdir()}
    assert {"convergence-avoidance", "separations-avoidance", "trajectories-avoidance"} <= stems
    assert "The small and the large action space side by side" in report


def test_names_the_missing_table_of_an_evaluation(run):
    stored = json.loads((run / "results.json").read_text())
    (run / "results.json").write_text(json.dumps(stored | {"rows": [stored["rows"][0]]}))
    (run / "evaluation/lateral-s0-skystack-stacked/episodes.parquet").unlink()
    with pytest.raises(InputError, match=r"episodes\.parquet: missing"):
        write_figures(run)


def stems(run):
    """The names of the figures that are drawn."""
    return {path.stem for path in write_figures(run)}


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_untrained_rows_are_not_drawn(tmp_path):
    """Their learning curves are: they show why."""
    rows = [("lateral-undamped", False), ("lateral", True), ("do-nothing-lateral", False)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=2)
    for experiment, stacking, rate in zip(*zip(*rows, strict=True), (0.4, 0.5, 0.2), strict=True):
        change_row(run, experiment, stacking, success_rate=rate)
    drawn = stems(run)
    for kind in ("trajectory", "histogram"):
        assert {name for name in drawn if name.startswith(f"{kind}-")} == {
            f"{kind}-lateral-stacked",
            f"{kind}-do-nothing-lateral-plain",
        }
    assert {"learning-lateral-undamped", "learning-lateral", "success-lateral"} <= drawn
    assert {"trajectories-lateral", "histograms-lateral"} <= drawn


@pytest.mark.slow
@pytest.mark.usefixtures("blank_pictures")
def test_draws_no_flights_if_no_policy_is_trained(run):
    change_row(run, "lateral", success_rate=0.29)
    assert stems(run) == {
        *("loop", "sector", "routes"),
        *("learning-lateral", "success-lateral"),
    }


@pytest.fixture
def panels(monkeypatch, blank_pictures):
    """The panels of each combined figure that is drawn."""
    drawn = {"histograms": [], "separations": [], "pictures": []}

    def instead_of(name):
        def draw(panels, **_):
            drawn[name].append(panels)
            return Figure((1.0, 1.0))

        return draw

    for name in drawn:
        monkeypatch.setattr(figures, name, instead_of(name))
    return drawn


def test_histograms_contain_the_scenarios_of_all_seeds(tmp_path, panels):
    run = write_run(tmp_path / "run", rows=[("avoidance", True)], seeds=(0, 1, 5), scenarios=2)
    (row,) = json.loads((run / "results.json").read_text())["rows"]
    write_figures(run)
    (histogram,), (nearest,) = panels["histograms"][0], panels["separations"][0]
    assert len(histogram.clearances) == len(nearest.separation_nm) == row["episodes"] == 6
    assert histogram.clearances.mean() == row["clearances_mean"]
    assert set(nearest.separation_nm) == {12.5}
    assert (nearest.lost, nearest.standard_nm) == (0, 5.0)


@pytest.mark.slow
def test_combined_histograms_leave_out_rows_that_repeat_others(run, panels):
    """Doing nothing, shipped policies, and in lateral navigation the less important rows."""
    for experiment in ("lateral-large", "lateral-best", "lateral-undamped", "lateral-shipped"):
        add_copy(run, experiment)
    add_copy(run, "do-nothing-lateral")
    change_row(run, "do-nothing-lateral", success_rate=0.0)
    drawn = stems(run)
    assert "histogram-lateral-shipped-stacked" in drawn
    assert "histogram-lateral-large-stacked" in drawn
    titles = [panel.title for panel in panels["histograms"][0]]
    assert titles == ["Damped and stacked", "Ours, stacked"]


def test_combined_histograms_show_all_rows_if_none_is_known(run, panels):
    for experiment in ("mine", "yours", "mine-shipped"):
        add_copy(run, experiment)
    change_row(run, "lateral", success_rate=0.0)
    write_figures(run)
    assert [panel.title for panel in panels["histograms"][0]] == ["Mine, stacked", "Yours, stacked"]


def test_combined_histograms_of_other_families_show_all_rows(tmp_path, panels):
    run = write_run(tmp_path / "run", rows=[("avoidance", True)], seeds=(0,), scenarios=1)
    for experiment in ("avoidance-large", "avoidance-shipped"):
        add_copy(run, experiment, of="avoidance", task="avoidance")
    write_figures(run)
    for kind in ("histograms", "separations"):
        titles = [panel.title for panel in panels[kind][0]]
        assert titles == ["Avoidance, stacked", "Avoidance, 37 actions, stacked"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["do-nothing-lateral", "do-nothing"])
def test_combined_picture_shows_doing_nothing(tmp_path, panels, name):
    """Also that of old files."""
    rows = [("lateral", True), ("do-nothing-lateral", False)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=1)
    change_row(run, "do-nothing-lateral", False, experiment=name)
    folder = run / "evaluation"
    (folder / "do-nothing-lateral-s0-skystack-plain").rename(folder / f"{name}-s0-skystack-plain")
    write_figures(run)
    titles = [title for title, _ in panels["pictures"][0]]
    assert titles == ["Damped and stacked", "Do nothing"]
