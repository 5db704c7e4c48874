"""A flown scenario as a BlueSky scenario file."""

from pathlib import Path

from skystack.errors import InputError, error_context
from skystack.evaluation.stored import stored_scenario
from skystack.io.files import atomic_write
from skystack.platforms.bluesky_scenario import scenario_text
from skystack.platforms.registry import scenario_notes
from skystack.simulator.scenario_file import Scenario, load_scenario


def export_scenario(source: Path, number: int | None, output: Path) -> list[str]:
    """Write a scenario with its clearances as a BlueSky scenario file (`.scn`).

    `source` is a scenario file (JSON), or the folder of an evaluation and the number of one of its
    scenarios. Returns notes for the user on what BlueSky flies differently. Raises InputError for a
    source that cannot be read or expressed in BlueSky's commands, or an output that cannot be
    written.
    """
    scenario = _scenario(source, number)
    with error_context(str(source)):
        text = scenario_text(scenario)
    atomic_write(output, text.encode())
    return scenario_notes("bluesky", scenario)


def _scenario(source: Path, number: int | None) -> Scenario:
    if source.is_dir():
        return stored_scenario(source, number or 0)
    if number is not None:
        raise InputError(f"--scenario is {number} (allowed: only with the folder of an evaluation)")
    return load_scenario(source)
