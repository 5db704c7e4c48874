"""Alternatives to skystack, measured in the same run, each in its own process."""

import io
import os
import tempfile
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax

from skystack.benchmarking import plain_ppo
from skystack.benchmarking.figures import Figure, rates
from skystack.benchmarking.run import Effort, alone
from skystack.compilation.programs import compile_for_cores
from skystack.errors import InputError, PlatformError
from skystack.learning.experiment import load_experiment
from skystack.learning.seeds import scenario_key
from skystack.platforms.conversion import scenario_of
from skystack.platforms.registry import open_platform
from skystack.simulator.traffic import callsigns
from skystack.tasks.navigation_kinds import build_navigation
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SB3_STEPS = 2048
"""Steps per measurement: Stable-Baselines3's default between updates."""
PEER_STEPS = 300


class Peer(NamedTuple):
    """An alternative to measure."""

    name: str
    ours: str
    """The name of skystack's figure for the same work."""
    measure: Callable[[int], tuple[float, ...]]
    """Returns the steps per second of each of a number of repetitions."""
    configuration: str


def measure_peers(
    effort: Effort, on_peer: Callable[[str], None]
) -> tuple[list[Figure], dict[str, str]]:
    """The figures of the installed peers, and the reason why each other one is missing.

    `on_peer` is called with the name of each peer before it is measured.
    """
    figures, missing = [], {}
    for peer in PEERS:
        on_peer(peer.name)
        try:
            found = alone(peer.measure, effort.processes)
        except (ImportError, InputError, PlatformError) as error:
            missing[peer.name] = str(error)
        else:
            figures.append(Figure(peer.name, "steps/s", found, peer.configuration))
    return figures, missing


def ratios(figures: list[Figure]) -> dict[str, float]:
    """How many times as fast as each peer skystack is, by the medians of one run."""
    medians = {figure.name: figure.median for figure in figures}
    return {
        peer.name: medians[peer.ours] / medians[peer.name]
        for peer in PEERS
        if peer.name in medians and peer.ours in medians
    }


def pure_jax(repetitions: int) -> tuple[float, ...]:
    compile_for_cores(1)
    experiment = load_experiment("lateral")
    task, settings = build_task(experiment.task), experiment.ppo
    carry = jax.jit(partial(plain_ppo.start, task, settings))(jax.random.key(0))
    update = jax.jit(partial(plain_ppo.update, task, settings))

    def run() -> None:
        nonlocal carry
        for _ in range(10):
            carry, loss = update(carry)
        jax.device_get(loss)

    return rates(run, 10 * settings.samples, repetitions)


def sb3_on_ours(repetitions: int) -> tuple[float, ...]:
    from skystack.gym.environment import TaskEnvironment  # noqa: PLC0415

    task = build_task(load_experiment("lateral").task)
    return _stable_baselines3(TaskEnvironment(task), repetitions)


def sb3_on_bluebird(repetitions: int) -> tuple[float, ...]:
    return _stable_baselines3(_bluebird(), repetitions)


def _stable_baselines3(environment: Any, repetitions: int) -> tuple[float, ...]:
    import torch  # noqa: PLC0415
    from stable_baselines3 import PPO  # noqa: PLC0415

    sizes = {"pi": [64, 64], "vf": [64, 64]}
    policy = {"net_arch": sizes, "activation_fn": torch.nn.ReLU}
    model = PPO("MlpPolicy", environment, n_steps=SB3_STEPS, policy_kwargs=policy, device="cpu")
    return rates(lambda: model.learn(SB3_STEPS), SB3_STEPS, repetitions)


def bluebird_environment(repetitions: int) -> tuple[float, ...]:
    return _random_steps(_bluebird(), repetitions)


def _bluebird() -> Any:
    """X-Plus with two aircraft under one controller, with the paper's five actions."""
    from bluebird_gymnasium.envs import SectorXPlusEnv  # noqa: PLC0415

    config = SectorXPlusEnv.get_default_env_config()
    config.scenario_config["args"]["num_aircraft"] = 2
    config.view_config["centralized_params"]["num_sampled_aircraft"] = 2
    config.action_config["simple_heading_route_parallel"] = False
    return SectorXPlusEnv(config)


def bluesky_environment(repetitions: int) -> tuple[float, ...]:
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOME"] = folder  # BlueSky writes there
        import bluesky_gym  # noqa: PLC0415
        import gymnasium  # noqa: PLC0415

        with redirect_stdout(io.StringIO()):
            bluesky_gym.register_envs()
            return _random_steps(gymnasium.make("SectorCREnv-v0"), repetitions)


def _random_steps(environment: Any, repetitions: int) -> tuple[float, ...]:
    environment.reset(seed=0)
    environment.action_space.seed(0)

    def run() -> None:
        for _ in range(PEER_STEPS):
            _, _, terminated, truncated, _ = environment.step(environment.action_space.sample())
            if terminated or truncated:
                environment.reset()

    return rates(run, PEER_STEPS, repetitions)


def platform(name: str, repetitions: int) -> tuple[float, ...]:
    """Another simulator by itself: two aircraft, no observations, rewards or instructions."""
    task = build_navigation(NavigationSettings())
    traffic, exit_level_ticks = jax.device_get(jax.jit(task.scenarios.draw)(scenario_key(0, 0)))
    names = callsigns(len(traffic.level_ticks))
    scenario = scenario_of(
        traffic, task.simulator, task.performance, PEER_STEPS, names, exit_level_ticks
    )
    with tempfile.TemporaryDirectory() as folder:
        simulator = open_platform(name, Path(folder))

        def run() -> None:
            simulator.reset(scenario)
            for _ in range(PEER_STEPS):
                simulator.advance()

        measured = rates(run, PEER_STEPS, repetitions)
        simulator.close()
    return measured


TRAINING, STEPPING = "training, lateral", "simulator, 2 aircraft"
PEERS = (
    Peer(
        "plain JAX PPO on our task",
        TRAINING,
        pure_jax,
        "written like PureJaxRL, settings of `lateral`, see skystack/benchmarking/plain_ppo.py",
    ),
    Peer(
        "Stable-Baselines3 PPO on our environment",
        TRAINING,
        sb3_on_ours,
        f"`lateral`, one environment, default settings, two layers of 64, {SB3_STEPS} steps",
    ),
    Peer(
        "Stable-Baselines3 PPO on bluebird-gymnasium",
        TRAINING,
        sb3_on_bluebird,
        f"SectorXPlusEnv, two aircraft, default settings, two layers of 64, {SB3_STEPS} steps",
    ),
    Peer(
        "bluebird-gymnasium",
        STEPPING,
        bluebird_environment,
        f"SectorXPlusEnv, two aircraft, random actions, {PEER_STEPS} steps",
    ),
    Peer(
        "BluebirdDT by itself",
        STEPPING,
        partial(platform, "bluebird"),
        f"two aircraft, no instructions, {PEER_STEPS} cycles",
    ),
    Peer(
        "BlueSky-Gym",
        STEPPING,
        bluesky_environment,
        f"SectorCREnv-v0, one agent, random actions, {PEER_STEPS} steps",
    ),
    Peer(
        "BlueSky by itself",
        STEPPING,
        partial(platform, "bluesky"),
        f"two aircraft, no instructions, {PEER_STEPS} cycles of 6 s",
    ),
)
