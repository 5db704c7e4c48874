"""The cases of `test_processes.py`, each run in its own process: `python forking.py CASE`.

A fork while JAX is running may hang if it is not rejected, so each case is a process that can be
killed. The last line that it prints is its result as JSON.
"""

import json
import multiprocessing
import os
import sys
import traceback

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

NAME = "skystack.gym:skystack/Lateral-v0"
ACTIONS = np.random.default_rng(0).integers(5, size=(30, 2))
LIMIT = 12


def start_jax():
    import jax

    jax.numpy.ones(3).block_until_ready()


def single():
    return gymnasium.make(NAME, max_episode_steps=LIMIT)


def fly(environment):
    """Fly several scenarios, and return all observations and rewards."""
    seen = [environment.reset(seed=3)[0].tolist()]
    for actions in ACTIONS:
        observation, rewards, *_ = environment.step(actions)
        seen.append([observation.tolist(), rewards.tolist()])
    environment.close()
    return seen


def asynchronous(context):
    return AsyncVectorEnv([single] * 2, context=context)


def same_as_synchronous(context):
    """Fly in subprocesses first, because flying in this process starts JAX."""
    theirs = fly(asynchronous(context))
    ours = fly(SyncVectorEnv([single] * 2))
    return theirs == ours and len(theirs) == len(ACTIONS) + 1


def async_forked():
    environment = gymnasium.make_vec(
        NAME, 2, vectorization_mode="async", max_episode_steps=LIMIT, vector_kwargs={}
    )
    return fly(environment) == fly(SyncVectorEnv([single] * 2))


def async_forked_too_late():
    start_jax()
    environment = asynchronous("fork")
    try:
        environment.reset(seed=3)
    except ValueError as error:
        environment.close()
        return [type(error).__name__, str(error)]
    return None


def async_spawned():
    start_jax()
    return same_as_synchronous("spawn")


def async_forkserver():
    start_jax()
    return same_as_synchronous("forkserver")


def fly_with_sb3(environment):
    environment.seed(3)
    seen = [environment.reset().tolist()]
    for actions in ACTIONS:
        observation, rewards, *_ = environment.step(actions)
        seen.append([observation.tolist(), rewards.tolist()])
    environment.close()
    return seen


def sb3_forked():
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    theirs = fly_with_sb3(SubprocVecEnv([single] * 2, start_method="fork"))
    return theirs == fly_with_sb3(DummyVecEnv([single] * 2))


def sb3_forked_too_late():
    from stable_baselines3.common.vec_env import SubprocVecEnv

    start_jax()
    environment = SubprocVecEnv([single] * 2, start_method="fork")
    try:
        environment.reset()
    except (EOFError, ConnectionError):  # its workers print errors instead of passing them on
        return "ended"
    return None


def environments():
    """An environment of each class: its name, and functions that use it."""
    from skystack.gym.multi_agent import parallel_env
    from skystack.gym.registration import make_environment, make_vector_environment
    from skystack.gym.sb3 import StableBaselines3Environment
    from skystack.gym.stacked import StackedEnvironment

    many = np.zeros(2, dtype=int)
    vector = make_vector_environment("lateral", 2, render_mode="rgb_array")
    for_sb3 = StableBaselines3Environment(
        make_vector_environment("lateral", 2, autoreset_mode="SameStep")
    )
    mask = {"reset_mask": np.array([True, False])}
    one = make_environment("lateral", render_mode="rgb_array")
    agents = parallel_env("lateral", render_mode="rgb_array")
    return {
        "single": [
            lambda: one.reset(seed=1),
            lambda: one.step(1),
            lambda: one.instruct(1),
            lambda: one.may_stack(1),
            one.observe,
            one.advance,
            one.render,
        ],
        "stacked": reset_and_step(StackedEnvironment(make_environment("lateral")), 1),
        "vector": [
            *reset_and_step(vector, many),
            vector.render,
            lambda: vector.reset(options=mask),
        ],
        "for Stable-Baselines3": [for_sb3.reset, lambda: for_sb3.step(many)],
        "agents": [*reset_and_step(agents, {"AC1": 1}), agents.state, agents.render],
    }


def reset_and_step(environment, action):
    return [lambda: environment.reset(seed=1), lambda: environment.step(action)]


def plain_task():
    import jax

    import skystack

    plain = skystack.PlainTask(
        skystack.build_task(skystack.load_experiment("lateral").task),
    )
    key = jax.random.key(0)
    seen = plain.reset(key)
    state = plain.state_of(seen)
    return [
        lambda: plain.reset(key),
        lambda: plain.begin(state),
        lambda: plain.state_of(seen),
        lambda: plain.observe(seen),
        lambda: plain.may_stack(seen, 1),
        lambda: plain.instruct(seen, 1),
        lambda: plain.advance(seen),
        lambda: plain.step(seen, 1),
        lambda: skystack.stack(plain, lambda observation: 1, seen),
    ]


def outcome_of(use):
    try:
        use()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "works"


def outcomes_of(kinds):
    return {kind: [outcome_of(use) for use in uses] for kind, uses in kinds.items()}


def in_a_fork(work):
    """The result of `work` in a forked child process."""
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(writes, json.dumps(work()).encode())
        except BaseException:
            traceback.print_exc()
        os._exit(0)
    os.close(writes)
    with os.fdopen(reads) as pipe:
        result = json.load(pipe)
    os.waitpid(child, 0)
    return result


def every_kind_made_before_a_fork():
    kinds = environments()
    return in_a_fork(lambda: outcomes_of(kinds))


def every_kind_used_before_a_fork():
    kinds = environments() | {"plain": plain_task()}
    for uses in kinds.values():
        for use in uses:
            use()
    return in_a_fork(lambda: outcomes_of(kinds))


def every_kind_made_in_a_fork():
    start_jax()
    return in_a_fork(lambda: outcomes_of(environments()))


def imported_after_a_fork():
    """The parent has used JAX, but has not imported skystack."""
    start_jax()
    assert not any(name.startswith("skystack") for name in sys.modules)
    return in_a_fork(lambda: outcomes_of({"single": reset_and_step(single(), 1)}))


def grandchild():
    start_jax()
    return in_a_fork(
        lambda: in_a_fork(lambda: outcomes_of({"single": reset_and_step(single(), 1)}))
    )


def multiprocessing_child():
    """The error is not caught: the child prints it and exits."""
    start_jax()
    child = multiprocessing.get_context("fork").Process(target=reset_single)
    child.start()
    child.join()
    return child.exitcode


def reset_single():
    single().reset(seed=0)


if __name__ == "__main__":
    case = sys.argv[1]
    sys.stdout.write(json.dumps(globals()[case]()) + "\n")
