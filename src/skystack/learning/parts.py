"""Updates in parts that run at the same time.

Environments do not influence each other before the gradient steps, so each part collects with some
of them, and computes values and advantages. The result is bit-identical to that of `ppo.update` if
each part has at least as many agents as are computed at once.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from skystack.compilation.programs import compile_for_cores, run_in_calling_threads
from skystack.io.signals import wait_for
from skystack.learning import ppo
from skystack.learning.collection import Draws, TrainState, collect, draw
from skystack.learning.settings import PPOSettings
from skystack.tasks.contract import ManyAgents, Task

CORES = 2
"""Training of tasks with several agents is compiled for this many cores, whatever the machine has,
so that the result does not depend on the machine."""

Update = Callable[[TrainState], tuple[TrainState, dict[str, Float[Array, ""]]]]
"""A compiled `ppo.update`. Returns the train state, and the update's metrics by name."""


def cores_for(task: Task) -> int:
    """The number of cores that training on a task is compiled for.

    One for tasks with one agent: their gradient steps are too small to gain from several cores.
    """
    return CORES if isinstance(task, ManyAgents) else 1


def prepare_process(task: Task) -> None:
    """Prepare this process for training on a task. Call this before JAX is used."""
    run_in_calling_threads()
    compile_for_cores(cores_for(task))


def compile_update(
    task: Task, settings: PPOSettings, like: TrainState, parts: int | None = None
) -> Update:
    """Compile `ppo.update` in parts, which run at the same time after `prepare_process`.

    By default, there are as many parts as `cores_for`, but only one on a GPU, or if the
    environments cannot be divided equally. The number of `parts` must divide that of the
    environments. `like` has the shapes and types of the train state; its values are not used.
    """
    if parts is None:
        cores = cores_for(task)
        divides = settings.environments % cores == 0 and jax.default_backend() == "cpu"
        parts = cores if divides else 1
    # No buffer donation: the previous train state stays valid if the run is interrupted.
    if parts == 1:
        whole: Update = jax.jit(partial(ppo.update, task, settings)).lower(like).compile()
        return whole
    number = jnp.int32(0)
    samples_of_part = partial(_samples_of_part, task, settings, parts)
    samples = jax.eval_shape(samples_of_part, like, number)
    part = jax.jit(samples_of_part).lower(like, number).compile()
    improve = jax.jit(partial(_improve, task, settings)).lower([samples] * parts).compile()

    def update(train_state: TrainState) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
        with ThreadPoolExecutor(parts, thread_name_prefix="collect") as threads:
            started = [
                threads.submit(part, train_state, jnp.int32(index)) for index in range(parts)
            ]
            improved: tuple[TrainState, dict[str, Float[Array, ""]]] = improve(
                [wait_for(each) for each in started]
            )
            return improved

    return update


def _samples_of_part(
    task: Task,
    settings: PPOSettings,
    parts: int,
    train_state: TrainState,
    number: Int[Array, ""],
) -> ppo.Samples:
    """The samples of part `number`."""
    size = settings.environments // parts

    def of_part(values: Array) -> Array:
        """The last axis has the environments, or the environments of each agent in turn."""
        by_agent = values.reshape(*values.shape[:-1], -1, settings.environments)
        chosen = jax.lax.dynamic_slice_in_dim(by_agent, number * size, size, axis=-1)
        return chosen.reshape(*values.shape[:-1], -1)

    state = train_state._replace(
        scenarios=jax.tree.map(of_part, train_state.scenarios),
        observations=of_part(train_state.observations),
        returns=of_part(train_state.returns),
    )
    draws: Draws = jax.tree.map(of_part, draw(task, settings, train_state))
    return ppo.samples_of(settings, collect(task, settings, state, draws))


def _improve(
    task: Task, settings: PPOSettings, samples: Sequence[ppo.Samples]
) -> tuple[TrainState, dict[str, Float[Array, ""]]]:
    """`ppo.improve`, with the samples of all parts."""
    size = settings.environments // len(samples)

    def joined(*values: Array) -> Array:
        by_environment = (each.reshape(*each.shape[:-1], -1, size) for each in values)
        whole = jnp.concatenate(list(by_environment), axis=-1)
        return whole.reshape(*whole.shape[:-2], -1)

    states = [each.train_state for each in samples]
    train_state = states[0]._replace(
        scenarios=jax.tree.map(joined, *(each.scenarios for each in states)),
        observations=joined(*(each.observations for each in states)),
        returns=joined(*(each.returns for each in states)),
    )
    # The train state is joined above: some of its values are the same in all parts.
    others = jax.tree.map(joined, *(each[1:] for each in samples))
    return ppo.improve(task, settings, ppo.Samples(train_state, *others))
