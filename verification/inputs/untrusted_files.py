"""The formats of untrusted files: valid files to start from, and the reader of each format."""

import hashlib
import json
import tempfile
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from importlib.resources import files
from pathlib import Path
from random import Random
from typing import Any

import gymnasium
import jax
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skystack.agents.agent import Agent
from skystack.agents.find import find_agent
from skystack.agents.queries import QueryNames, query_actions
from skystack.agents.sector_agents import sector_task_of
from skystack.airspace.sectors import find_sector
from skystack.evaluation.evaluate import (
    Conditions,
    agent_task,
    evaluate,
    policy_task,
)
from skystack.evaluation.simulate import simulate_file
from skystack.evaluation.stored import stored_scenario
from skystack.evaluation.summary import aggregate, evaluation_folder
from skystack.export.onnx_file import export_onnx
from skystack.learning import ppo
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.experiment import load_experiment, to_toml
from skystack.learning.policy import load_policy
from skystack.learning.seeds import training_key
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from skystack.reporting.claims import check_claims
from skystack.reporting.comparison import comparison_json, comparison_tables
from skystack.reporting.flights import read_scenario, read_sector
from skystack.reporting.markdown import as_markdown
from skystack.reporting.replay.page import page_data
from skystack.reporting.replay.recording import as_json, read_replay
from skystack.reporting.results import read_run
from skystack.reporting.trainings import read_runs
from skystack.reporting.typical import kind_of_scenario, typical_scenario
from skystack.simulator.scenario_file import Scenario, load_scenario
from skystack.tasks.registry import build_training_task
from skystack.tasks.sector_control import SectorControl
from verification.inputs import mutators
from verification.inputs.mutators import HOSTILE
from verification.inputs.texts import texts_in, with_text

Files = Mapping[str, bytes]
"""A folder: the contents of its files by name."""

EXAMPLES = Path(__file__).parents[2] / "examples"
OWN_SECTOR = EXAMPLES / "own-sector"
PACKAGE = Path(str(files("skystack")))
POLICY = "lateral-best"
FLOWN = f"{POLICY}-s0-skystack-stacked"


ANOTHER_TEXT = 0.2
"""The probability that a mutation only replaces one text, by a path or text for a terminal."""


@dataclass(frozen=True)
class Format:
    """One format: valid folders, which of their files are mutated, and the reader of a folder.

    `read` also uses the contents. It raises InputError for a refused file, and AssertionError for a
    result with a non-finite number.
    """

    name: str
    seeds: tuple[Files, ...]
    read: Callable[[Path], object]
    mutates: str = ""
    """The suffix of the files that are mutated; all files by default."""
    repair: Callable[[Random, dict[str, bytes]], None] = lambda random, folder: None
    """A repair after the mutation, so that more than the first check is reached."""

    def mutated(self, random: Random) -> dict[str, bytes]:
        """A valid folder with one or two of its files mutated."""
        folder = dict(random.choice(self.seeds))
        names = sorted(name for name in folder if name.endswith(self.mutates))
        for name in random.sample(names, min(len(names), random.choice((1, 1, 1, 2)))):
            folder[name] = _mutated(random, name, folder[name])
        self.repair(random, folder)
        return folder


def _mutated(random: Random, name: str, data: bytes) -> bytes:
    places = texts_in(name, data) if random.random() < ANOTHER_TEXT else ()
    if places:
        try:
            return with_text(name, data, random.choice(places), random.choice(HOSTILE))
        except (ValueError, pa.ArrowException):  # the format cannot hold the text
            return mutators.mutated_bytes(random, data)
    return _MUTATORS.get(Path(name).suffix, mutators.mutated_bytes)(random, data)


@lru_cache(maxsize=64)
def _table(data: bytes) -> pa.Table:
    return pq.read_table(pa.BufferReader(data))


_MUTATORS: Mapping[str, Callable[[Random, bytes], bytes]] = {
    ".json": mutators.mutated_json,
    ".geojson": mutators.mutated_json,
    ".jsonl": mutators.mutated_json_lines,
    ".toml": lambda random, data: mutators.mutated_toml(random, data, tomllib.loads),
    ".safetensors": mutators.mutated_safetensors,
    ".parquet": lambda random, data: mutators.mutated_parquet(random, _table(data), data),
    ".onnx": mutators.mutated_onnx,
    ".zip": mutators.mutated_zip,
}


def _folder(root: Path, *names: str, **others: Path) -> Files:
    """Files of a folder under their own names, and others under `name` with their own suffix."""
    renamed = {f"{name}{path.suffix}": path.read_bytes() for name, path in others.items()}
    return {name: (root / name).read_bytes() for name in names} | renamed


_SECTOR_FILES = ("valley.json", "valley.geojson")


def _scenario() -> Format:
    plain = [_folder(EXAMPLES, scenario=path) for path in sorted(EXAMPLES.glob("*.json"))]
    meeting = _folder(OWN_SECTOR, *_SECTOR_FILES, scenario=OWN_SECTOR / "meeting.json")
    known: list[tuple[Scenario, Skystack]] = []

    def read(folder: Path) -> None:
        scenario = load_scenario(folder / "scenario.json")
        simulator = scenario.simulator()
        _finite("the start", *jax.tree.leaves(scenario.initial_traffic(simulator)))
        if len(known) < 4:
            known.append((scenario, Skystack()))
        for seed, platform in known:  # any other would have to be compiled
            if len(seed.aircraft) == len(scenario.aircraft) and seed.simulator() == simulator:
                _finite("the flight", *fly_scenario(platform, replace(scenario, cycles=2)).reports)
                break

    return Format("scenario", (*plain, meeting), read)


def _sector() -> Format:
    shipped = sorted((PACKAGE / "sectors").glob("*.json"))
    seeds = [_folder(OWN_SECTOR, sector=path) for path in shipped]
    own = _folder(OWN_SECTOR, "valley.geojson", sector=OWN_SECTOR / "valley.json")
    return Format("sector", (*seeds, own), _read_sector)


def _geojson() -> Format:
    own = _folder(OWN_SECTOR, "valley.geojson", sector=OWN_SECTOR / "valley.json")
    area = json.loads(own["valley.geojson"])
    wrapped = {"type": "Feature", "properties": {"name": "valley"}, "geometry": area}
    seeds = [wrapped, {"type": "FeatureCollection", "features": [wrapped]}]
    if area["type"] != "Polygon":
        seeds = []
    return Format(
        "geojson",
        (own, *({**own, "valley.geojson": json.dumps(seed).encode()} for seed in seeds)),
        _read_sector,
        mutates=".geojson",
    )


def _read_sector(folder: Path) -> None:
    sector = find_sector("sector.json", folder)
    _finite("the sector", sector.area_nm, *sector.route_table)


def _experiment() -> Format:
    shipped = sorted((PACKAGE / "experiments").glob("*.toml"))
    seeds = [_folder(OWN_SECTOR, experiment=path) for path in shipped]
    own = _folder(OWN_SECTOR, *_SECTOR_FILES, experiment=OWN_SECTOR / "valley.toml")

    def read(folder: Path) -> None:
        experiment = load_experiment(str(folder / "experiment.toml"))
        values = tomllib.loads(to_toml(experiment).decode())
        _finite("the settings", [x for x in _leaves(values) if isinstance(x, float)])

    return Format("experiment", (*seeds, own), read)


def _policy() -> Format:
    shipped = sorted(path.parent for path in (PACKAGE / "policies").glob("*/policy.json"))
    seeds = [_folder(folder, "policy.json", "policy.safetensors") for folder in shipped]
    random = np.random.default_rng(0)

    def read(folder: Path) -> None:
        policy = load_policy(folder)
        size = len(policy.description.observation)
        observations = random.random((4, size), dtype=np.float32).round(random.integers(4))
        _finite("the output", policy.logits(observations))
        if policy.description.task_name == SectorControl.name:
            sector_task_of(policy)
        else:
            policy_task(policy)

    return Format("policy", tuple(seeds), read, repair=_update_hash)


def _update_hash(random: Random, folder: dict[str, bytes]) -> None:
    """Mostly update the sha256 of the weights, so that other checks are reached."""
    try:
        described = json.loads(folder["policy.json"])
    except (ValueError, RecursionError):
        return
    if isinstance(described, dict) and "sha256" in described and random.random() < 0.9:
        found = hashlib.sha256(folder["policy.safetensors"]).hexdigest()
        old = described["sha256"]
        if isinstance(old, str) and old:
            text = folder["policy.json"]
            folder["policy.json"] = text.replace(old.encode("utf-8", "ignore"), found.encode())


def _onnx() -> Format:
    names = ("lateral", POLICY)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.onnx"
        seeds = []
        for name in names:
            export_onnx(load_policy(PACKAGE / "policies" / name), path)
            seeds.append(_folder(Path(folder), path.name))
    return Format("onnx", tuple(seeds), lambda folder: _read_agent(folder / path.name, None))


def _sb3() -> Format:
    from stable_baselines3 import DQN, PPO  # noqa: PLC0415  (an extra)

    spaces = gymnasium.spaces
    environment = _OnlySpaces(spaces.Box(0.0, 1.0, (8,), np.float32), spaces.Discrete(5))
    seeds = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.zip"
        for kind, settings in ((PPO, {}), (DQN, {"buffer_size": 10})):
            layers = {"net_arch": [4]}  # so that weights are not most of the file
            model = kind("MlpPolicy", environment, policy_kwargs=layers, device="cpu", **settings)
            model.save(path)
            seeds.append(_folder(Path(folder), path.name))
    read = partial(_read_agent, experiment="lateral-undamped")
    return Format("sb3", tuple(seeds), lambda folder: read(folder / path.name))


class _OnlySpaces(gymnasium.Env[Any, Any]):
    """An environment that has only its spaces."""

    def __init__(self, observation: Any, action: Any) -> None:
        self.observation_space, self.action_space = observation, action


def _read_agent(path: Path, experiment: str | None) -> None:
    """Read an agent as the verb `evaluate` does, and query it."""
    agent = find_agent(str(path))
    assert isinstance(agent, Agent)
    task = agent_task(agent, experiment)
    rows = np.zeros((3, len(task.observation_names)), np.float32)
    query_actions(agent, rows, QueryNames(range(3), 0), len(task.action_names))


def _checkpoint() -> Format:
    changes = ("ppo.environments=2", "ppo.steps=4", "ppo.minibatch=4", "ppo.hidden=[4]")
    experiment = load_experiment("lateral", changes)
    task = build_training_task(experiment.task)
    init, key = jax.jit(partial(ppo.init, task, experiment.ppo)), training_key(0)
    like = jax.eval_shape(init, key)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "learner.safetensors"
        save_checkpoint(path, init(key), "of the seed")
        seed = _folder(Path(folder), path.name)

    def read(folder: Path) -> None:
        learner = load_checkpoint(folder / path.name, like, "of the seed")
        shapes = jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), like)
        assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), learner) == shapes

    return Format("checkpoint", (seed,), read)


@cache
def _evaluation() -> tuple[Files, dict[str, Any]]:
    """The tables of a small evaluation, and its row."""
    with tempfile.TemporaryDirectory() as name:
        policy = load_policy(PACKAGE / "policies" / POLICY)
        evaluated = evaluate(policy, Conditions(episodes=2), Path(name))
        folder = evaluation_folder(Path(name), POLICY, 0, stacking=True)
        tables = _folder(folder, *(path.name for path in sorted(folder.glob("*.parquet"))))
    whole = aggregate([evaluated.row], [evaluated.episodes])
    return tables, {"rows": [whole], "rows_by_seed": [evaluated.row]}


def _tables() -> Format:
    evaluated = {f"{FLOWN}/{name}": data for name, data in _evaluation()[0].items()}
    with tempfile.TemporaryDirectory() as name:
        output = Path(name) / "flight.parquet"
        simulate_file(EXAMPLES / "head-on.json", output)
        simulated = _folder(Path(name), output.name)

    def read(folder: Path) -> None:
        if (folder / "flight.parquet").exists():
            replay = read_replay(folder / "flight.parquet")
        else:
            replay = read_replay(folder)
            scenario = stored_scenario(folder / FLOWN, 0)
            traffic = scenario.initial_traffic(scenario.simulator())
            _finite("the start", *jax.tree.leaves(traffic))
        as_json(page_data((replay,)))  # refuses a NaN

    return Format("tables", (evaluated, simulated), read)


def _run_folder() -> Format:
    tables, rows = _evaluation()
    learned = {"experiment": POLICY, "seed": 0, "steps": 4096, "wall_s": 2.0, "steps_per_s": 2048.0}
    results = rows | {"train": [learned], "wall_s": 3.0, "machine": "any", "version": "0"}
    results |= {"command": "skystack reproduce", "quick": True}
    update = {"steps": 1024, "wall_s": 0.5, "return": -3.0, "success": 0.5, "episodes": 4.0}
    update |= {"instructions": 12.0, "bursts": 4.0, "correct_exit": 0.5, "excursion": 0.5}
    lines = [json.dumps(update | {"steps": 1024 * number}) for number in range(1, 5)]
    policy = (PACKAGE / "policies" / POLICY / "policy.json").read_bytes()
    trained = f"train/{POLICY}-s0"
    folder = {
        "results.json": json.dumps(results).encode(),
        "bound.json": b'{"clearances_mean": 1.6, "scenarios": 100}',
        f"{trained}/config.toml": to_toml(load_experiment(POLICY)),
        f"{trained}/metrics.jsonl": "\n".join(lines).encode(),
        f"{trained}/policy.json": policy,
        **{f"evaluation/{FLOWN}/{name}": data for name, data in tables.items()},
    }
    return Format("run-folder", (folder,), _read_run)


def _read_run(folder: Path) -> None:
    """Read all that `skystack report` reads and make its tables; pictures would take too long."""
    run = read_run(folder)
    for family, rows in run.results.families.items():
        number = typical_scenario(run, rows)
        kind_of_scenario(run, rows, number)
        for row in rows:
            read_sector(run.evaluation(row))
            for track in read_scenario(run.evaluation(row), number).tracks:
                _finite(family, track.position_nm, track.level_fl, track.cleared_fl)
    check_claims(run)
    as_markdown(run)
    runs = read_runs([folder])
    comparison_tables(runs)
    msgspec.json.encode(comparison_json(runs))


def _finite(what: str, *arrays: Any) -> None:
    for values in (leaf for array in arrays for leaf in jax.tree.leaves(array)):
        if not np.issubdtype(np.asarray(values).dtype, np.number):
            continue
        assert np.all(np.isfinite(np.asarray(values))), f"{what} holds a non-finite number"


def _leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for each in value.values() for leaf in _leaves(each)]
    if isinstance(value, list):
        return [leaf for each in value for leaf in _leaves(each)]
    return [value]


FORMATS: dict[str, Callable[[], Format]] = {
    "scenario": _scenario,
    "sector": _sector,
    "geojson": _geojson,
    "experiment": _experiment,
    "policy": _policy,
    "onnx": _onnx,
    "sb3": _sb3,
    "checkpoint": _checkpoint,
    "tables": _tables,
    "run-folder": _run_folder,
}
