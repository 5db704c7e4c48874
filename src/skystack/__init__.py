"""skystack: online action-stacking for air traffic control.

The names that most programs need; each is imported when it is first used.

    find_policy       load a policy by name or from a run folder, as a numpy callable
    find_agent        the same, and also policies from ONNX or Stable-Baselines3 files
    evaluate          fly a policy or a function on held-out scenarios, under `Conditions`
    Batched           marks a function as a policy that takes a batch of observations
    load_experiment   load an experiment (a task and its training) by name or from a TOML file
    train_experiment  train an experiment; its files are written into a folder
    build_task        build the task from an experiment's settings
    find_sector       load a sector by name or from a file
    PlainTask         a task for plain Python: one scenario, numpy observations
    stack             online action-stacking of any policy over any `TwoPhase` environment
    InputError        raised for every mistake in names, files and settings
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

if TYPE_CHECKING:
    from skystack.agents.agent import Batched
    from skystack.agents.find import find_agent
    from skystack.airspace.sectors import find_sector
    from skystack.errors import InputError
    from skystack.evaluation.evaluate import Conditions, evaluate
    from skystack.learning.experiment import load_experiment
    from skystack.learning.progress import TrainingProgress
    from skystack.learning.run import train_experiment
    from skystack.policies.shipped import find_policy
    from skystack.stacking import Stack, TwoPhase, stack
    from skystack.tasks.plain import PlainTask
    from skystack.tasks.registry import build_task

__version__ = "0.1.0"

__all__ = [
    "Batched",
    "Conditions",
    "InputError",
    "PlainTask",
    "Stack",
    "TrainingProgress",
    "TwoPhase",
    "__version__",
    "build_task",
    "evaluate",
    "find_agent",
    "find_policy",
    "find_sector",
    "load_experiment",
    "stack",
    "train_experiment",
]

_MODULES = {
    "Batched": "agents.agent",
    "Conditions": "evaluation.evaluate",
    "InputError": "errors",
    "PlainTask": "tasks.plain",
    "Stack": "stacking",
    "TrainingProgress": "learning.progress",
    "TwoPhase": "stacking",
    "build_task": "tasks.registry",
    "find_agent": "agents.find",
    "find_policy": "policies.shipped",
    "find_sector": "airspace.sectors",
    "evaluate": "evaluation.evaluate",
    "load_experiment": "learning.experiment",
    "stack": "stacking",
    "train_experiment": "learning.run",
}


_RENAMED = {"judge": "evaluate"}
"""Names of older versions, which still work with a warning."""


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        message = f"skystack.{name} was renamed to skystack.{_RENAMED[name]}"
        warn(message, DeprecationWarning, stacklevel=2)
        name = _RENAMED[name]
    if name not in _MODULES:
        raise AttributeError(f"module 'skystack' has no attribute {name!r}")
    return getattr(import_module(f"skystack.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
