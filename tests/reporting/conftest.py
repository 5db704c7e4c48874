"""Run folders in the format of `skystack reproduce`, with flights of a crude controller."""

import json
import shutil
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from matplotlib.path import Path as MatplotlibPath

from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.learning.experiment import load_experiment, to_toml
from skystack.reporting import figures
from skystack.reporting.report import write_report

NM_PER_CYCLE, DEG_PER_CYCLE, CYCLES = 0.776, 9.0, 300
PAPER = {
    ("lateral-undamped", False): (113.0, 15.9),
    ("lateral", False): (14.5, 6.6),
    ("lateral", True): (7.2, 3.5),
    ("lateral-large", False): (6.3, 3.0),
}
UNTRAINED = {"do-nothing-lateral"}


@dataclass
class TableRows:
    """The rows of the four tables of an evaluation."""

    episodes: list = field(default_factory=list)
    aircraft: list = field(default_factory=list)
    trajectories: list = field(default_factory=list)
    clearances: list = field(default_factory=list)


def turn_to(heading, wanted):
    return (wanted - heading + 180.0) % 360.0 - 180.0


def wanted_turns(experiment, stacking, error_deg, instructed_before):
    """The number of 10-degree instructions that the controller issues at once, with sign."""
    if experiment in UNTRAINED:
        return 0
    if experiment == "lateral-undamped":
        return int(np.sign(error_deg)) if abs(error_deg) > 2.0 else 0
    slack = 16.0 if experiment == "lateral-best" else 9.0
    if abs(error_deg) < (6.0 if instructed_before else slack):
        return 0
    turns = round(error_deg / 10.0)
    return turns if stacking or experiment == "lateral-large" else int(np.sign(turns))


def fly_one(experiment, stacking, sector, scenario, number, callsign, rows):
    rng = np.random.default_rng([scenario, number])
    route = sector.routes[int(rng.integers(len(sector.routes)))]
    fixes = np.array([sector.fixes_nm[name] for name in route])
    position = fixes[0] + rng.uniform(-3.0, 3.0, size=2)
    heading = cleared = float(round(sector.first_heading_deg(route)))
    target, issued, instructions, instructed_before = 1, 0, 0, False
    entered = exited = excursion = False
    constants = (300.0, 465.9, 0.0)  # cleared level, ground speed, vertical speed
    area = MatplotlibPath(sector.area_nm)
    for cycle in range(CYCLES + 1):
        inside = bool(area.contains_point(position))
        entered = entered or inside
        excursion = excursion or (entered and not inside and target < len(fixes) - 1)
        status = "exited" if exited else "excursion" if excursion else "in_sector"
        status = status if entered else "before_entry"
        lat, lon = sector.plane.to_degrees(position)
        rows.trajectories.append(
            (
                scenario,
                cycle,
                6 * cycle,
                callsign,
                lat,
                lon,
                300.0,
                heading,
                cleared,
                *constants,
                status,
            )
        )
        if exited:
            break
        aim = fixes[min(target, len(fixes) - 1)]
        aim = aim + rng.normal(0.0, 2.0, size=2) * (experiment == "lateral-undamped")
        bearing = np.degrees(np.arctan2(*(aim - position)))
        turns = wanted_turns(experiment, stacking, turn_to(cleared, bearing), instructed_before)
        if experiment == "lateral-undamped" and cycle % 2 == number % 2:
            turns = 0  # the policy addresses one aircraft per cycle
        instructed_before = turns != 0
        if turns:
            cleared = round(cleared + 10.0 * turns) % 360
            side = "right" if turn_to(heading, cleared) >= 0.0 else "left"
            text = f"{callsign}, turn {side} heading {cleared:03d}"
            rows.clearances.append(
                (scenario, cycle, issued, callsign, "heading", cleared, side, abs(turns), text)
            )
            issued, instructions = issued + 1, instructions + abs(turns)
        heading = (heading + np.clip(turn_to(heading, cleared), -9.0, 9.0)) % 360.0
        position = position + NM_PER_CYCLE * np.array(
            [np.sin(np.radians(heading)), np.cos(np.radians(heading))]
        )
        distance_nm = np.linalg.norm(fixes - position, axis=1)
        if target < len(fixes) and distance_nm[target] < (6.0 if target < len(fixes) - 2 else 2.5):
            target += 1
        exited = target == len(fixes)
    rows.aircraft.append((scenario, callsign, "B753", " ".join(route), 300, 300))
    return issued, instructions, exited, excursion, cycle


COLUMNS = {
    "episodes": "scenario clearances instructions success correct_exit excursion few_clearances "
    "min_separation_nm loss_of_separation cycles",
    "aircraft": "scenario callsign type route entry_fl exit_fl",
    "trajectories": "scenario cycle time_s callsign lat lon fl heading_deg cleared_heading_deg "
    "cleared_fl ground_speed_kt vertical_speed_ft_min status",
    "clearances": "scenario cycle transmission callsign kind value direction instructions text",
}
TEXT = {"callsign", "type", "route", "status", "kind", "direction", "text"}


def as_table(name, rows) -> pa.Table:
    """Rows as a table, whose columns have the correct types even without rows."""
    columns = COLUMNS[name].split()
    values = zip(*rows, strict=True) if rows else [[] for _ in columns]
    return pa.table(
        {
            column: pa.array(list(cells), type=None if rows else missing_type(column))
            for column, cells in zip(columns, values, strict=True)
        }
    )


def missing_type(column):
    return pa.string() if column in TEXT else pa.int32()


def write_evaluation(folder: Path, experiment, stacking, scenarios, callsigns) -> pa.Table:
    sector: Sector = x_plus()
    rows = TableRows()
    for scenario in range(scenarios):
        results = [
            fly_one(experiment, stacking, sector, scenario, number, callsign, rows)
            for number, callsign in enumerate(callsigns)
        ]
        issued, instructions, exited, excursion, cycles = zip(*results, strict=True)
        last = {row[3]: row for row in rows.trajectories if row[0] == scenario}
        rows.trajectories += [
            (scenario, cycle, 6 * cycle, *row[3:])
            for row in last.values()
            for cycle in range(row[1] + 1, max(cycles) + 1)
        ]
        all_exited, any_excursion = all(exited), any(excursion)
        outcome = (
            all_exited and not any_excursion,
            all_exited,
            any_excursion,
            True,
            12.5,
            False,
            max(cycles),
        )
        rows.episodes.append((scenario, sum(issued), sum(instructions), *outcome))
    folder.mkdir(parents=True)
    metadata = {b"sector": msgspec.json.encode(sector)}
    tables = {name: as_table(name, values) for name, values in vars(rows).items()}
    for name, table in tables.items():
        pq.write_table(table.replace_schema_metadata(metadata), folder / f"{name}.parquet")
    return tables["episodes"]


def write_metrics(folder: Path, updates: int, seed: int, slow: float) -> None:
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    lines = []
    for number in range(updates):
        learned = 1.0 - np.exp(-slow * number / updates)
        noisy = lambda value, spread=0.04: float(  # noqa: E731
            np.clip(value + rng.normal(0.0, spread), 0.0, 1.0)
        )
        ended = number > 0
        lines.append(
            {
                "steps": 8192 * (number + 1),
                "wall_s": 0.1 * number,
                "return": float(-500.0 + 520.0 * learned + rng.normal(0, 15)) if ended else None,
                "success": noisy(0.95 * learned**3) if ended else None,
                "correct_exit": noisy(0.97 * learned**2) if ended else None,
                "excursion": noisy(1.0 - 0.97 * learned) if ended else None,
                "few_instructions": noisy(learned**0.2, 0.01) if ended else None,
                "instructions": 100.0 * (1 - learned) + 14.0 if ended else None,
                "bursts": 80.0 * (1 - learned) + 6.0 if ended else None,
                "entropy": 1.6 - learned,
                "kl": 0.01,
                "clip_fraction": 0.1,
                "policy_loss": -0.01,
                "value_loss": 0.2,
                "episodes": 50 if ended else 0,
            }
        )
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "metrics.jsonl").write_text(text)


def row_of(experiment, stacking, seeds, episodes: pa.Table):
    column = {name: episodes[name].to_numpy() for name in episodes.column_names}
    paper = PAPER.get((experiment, stacking))
    return {
        "experiment": experiment,
        "seeds": seeds,
        "platform": "skystack",
        "stacking": stacking,
        "greedy": True,
        "episodes": episodes.num_rows,
        "clearances_mean": float(column["clearances"].mean()),
        "clearances_std": float(column["clearances"].std()),
        "instructions_mean": float(column["instructions"].mean()),
        "success_rate": float(column["success"].mean()),
        "correct_exit_rate": float(column["correct_exit"].mean()),
        "excursion_rate": float(column["excursion"].mean()),
        "few_clearances_rate": float(column["few_clearances"].mean()),
        "loss_of_separation_count": int(column["loss_of_separation"].sum()),
        "min_separation_nm_min": 12.5,
        "min_separation_nm_mean": 12.5,
        "paper": {"clearances_mean": paper[0], "clearances_std": paper[1]} if paper else None,
    }


def write_run(
    folder: Path,
    rows=(
        ("lateral-undamped", False),
        ("lateral", False),
        ("lateral", True),
        ("do-nothing-lateral", False),
    ),
    seeds=(0, 1),
    scenarios=4,
    updates=12,
    callsigns=("AC1", "AC2"),
) -> Path:
    """Write a run folder like that of `skystack reproduce`, with rows in reverse order."""
    results = {"rows": [], "rows_by_seed": [], "train": [], "wall_s": 245.0}
    results |= {"machine": "a test machine", "version": "0.1.0", "quick": True}
    results["command"] = "skystack reproduce lateral --quick"
    for experiment, stacking in reversed(rows):
        way = "stacked" if stacking else "plain"
        own_seeds = (0,) if experiment in UNTRAINED else seeds
        tables = []
        for seed in own_seeds:
            name = f"{experiment}-s{seed}-skystack-{way}"
            tables.append(
                write_evaluation(
                    folder / "evaluation" / name, experiment, stacking, scenarios, callsigns
                )
            )
            row = {"seed": seed} | row_of(experiment, stacking, 1, tables[-1])
            results["rows_by_seed"].append(row)
        row = row_of(experiment, stacking, len(own_seeds), pa.concat_tables(tables))
        results["rows"].append(row)
    for number, experiment in enumerate(dict.fromkeys(name for name, _ in rows)):
        for seed in () if experiment in UNTRAINED else seeds:
            training = folder / "train" / f"{experiment}-s{seed}"
            write_metrics(training, updates, seed, 8.0 - number)
            (training / "config.toml").write_bytes(to_toml(load_experiment(experiment)))
            results["train"].append(
                {"experiment": experiment, "seed": seed, "steps": 8192 * updates}
                | {"wall_s": 62.0, "steps_per_s": 8192 * updates / 62.0}
            )
    (folder / "results.json").write_text(json.dumps(results))
    bound = {"clearances_mean": 1.6, "per_scenario": [2, 1], "scenarios": 2}
    (folder / "bound.json").write_text(json.dumps(bound))
    return folder


def change_row(run: Path, experiment, stacking=True, /, **changes) -> None:
    """Change a row in `results.json`, but not the one of a single seed."""
    path = run / "results.json"
    results = json.loads(path.read_text())
    (row,) = (
        each
        for each in results["rows"]
        if (each["experiment"], each["stacking"]) == (experiment, stacking)
    )
    row |= changes
    path.write_text(json.dumps(results))


def add_copy(run: Path, experiment, of="lateral", task="lateral") -> None:
    """Add a stacked row of another experiment with the flights of the given one's first seed."""
    path = run / "results.json"
    results = json.loads(path.read_text())
    row = next(
        each for each in results["rows"] if each["experiment"] == of and each["stacking"] is True
    )
    results["rows"].append(row | {"experiment": experiment, "task": task, "seeds": 1})
    path.write_text(json.dumps(results))
    folder = run / "evaluation"
    shutil.copytree(
        folder / f"{of}-s0-skystack-stacked", folder / f"{experiment}-s0-skystack-stacked"
    )


@pytest.fixture
def run(tmp_path) -> Path:
    """A small run folder, new for each test."""
    return write_run(tmp_path / "run", rows=[("lateral", True)], seeds=(0,), scenarios=2)


@pytest.fixture
def blank_pictures(monkeypatch):
    """Compose figures, but write a number instead: for tests of their names and the text around.

    No two files are equal, so that a file that is written again is noticed. Fixtures for a whole
    session or module contain the true figures.
    """
    numbers = count()

    def save(figure, stem):
        paths = [stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg")]
        for path in paths:
            path.write_text(f"<svg><desc>{next(numbers)}</desc></svg>")
        return paths

    monkeypatch.setattr(figures, "save", save)


@pytest.fixture(scope="session")
def evil_callsign() -> str:
    """A browser would execute this if it were not escaped."""
    return "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="session")
def written(tmp_path_factory, evil_callsign) -> Path:
    """A larger run, shared and read-only; its callsigns contain markup."""
    folder = tmp_path_factory.mktemp("reported") / "run"
    return write_run(folder, callsigns=(evil_callsign, "$AC_2$"))


@pytest.fixture(scope="session")
def reported(written) -> Path:
    """The same run with its report."""
    write_report(written)
    return written
