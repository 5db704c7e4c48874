"""Export formats: scenarios as BlueSky files, policies as ONNX or numpy files."""

from collections.abc import Callable, Mapping
from pathlib import Path

from skystack.errors import InputError, exists
from skystack.export.numpy_file import export_numpy
from skystack.export.onnx_file import export_onnx
from skystack.export.scenario import export_scenario
from skystack.io.files import check_output
from skystack.learning.policy import Policy
from skystack.policies.shipped import find_policy, shipped_policies

POLICY_FORMATS: Mapping[str, Callable[[Policy, Path], None]] = {
    "onnx": export_onnx,
    "numpy": export_numpy,
}
"""The function that writes a policy in each format."""


def export(source: str, kind: str, scenario: int | None, output: Path) -> list[str]:
    """Export a source as a file of format `kind`.

    `source` is a scenario file or an evaluation's folder for `scn`, with the number of a scenario
    in the latter; a shipped policy's name or a run folder for the policy formats. Returns notes for
    the user. Raises InputError for a source that is missing, damaged or unsuitable for the format,
    and for an output that cannot be written.
    """
    check_output(output, Path(source))
    if kind not in POLICY_FORMATS:
        _refuse_policy(source)
        return export_scenario(Path(source), scenario, output)
    if scenario is not None:
        raise InputError(f"--scenario is {scenario} (allowed: only with --format scn)")
    _refuse_scenario(source, kind)
    POLICY_FORMATS[kind](find_policy(source), output)
    return []


def _refuse_policy(source: str) -> None:
    path = Path(source)
    named = source in shipped_policies() and not exists(path)
    if named or path.name == "policy.json" or exists(path / "policy.json"):
        raise InputError(
            f"--format scn is for flown scenarios, and {source} is a policy "
            f"(allowed: {', '.join(f'--format {kind}' for kind in POLICY_FORMATS)})"
        )


def _refuse_scenario(source: str, kind: str) -> None:
    path = Path(source)
    scenario = path.is_file() and path.name != "policy.json"
    if scenario or exists(path / "trajectories.parquet"):
        raise InputError(
            f"--format {kind} is for policies, and {source} holds flown scenarios "
            "(allowed: --format scn)"
        )
