"""Messages are one printable line, whatever names an untrusted file contains."""

import numpy as np
import pytest
import torch

from skystack.errors import LONGEST_LINE, InputError, check_known, checked_integer, unknown_name


def test_message_is_one_printable_line():
    assert str(InputError("a\nb\x1b[31m\ud800é")) == "a\\nb\\x1b[31m\\ud800é"


def test_truncates_a_long_message():
    assert str(InputError("x" * 1_000_000)) == "x" * LONGEST_LINE + "..."


@pytest.mark.slow
def test_suggests_no_name_among_very_many():
    names = [f"FIX{number}" for number in range(200_000)]
    assert "did you mean" not in str(unknown_name("fix", "FIX200000", names))


def test_names_are_listed_in_the_order_of_their_numbers():
    error = unknown_name("callsign", "x", {"AC10", "AC2", "AC1", "BAW2A", "BAW"})
    assert "(allowed: AC1, AC2, AC10, BAW, BAW2A)" in str(error)


def test_says_if_no_name_is_allowed():
    assert str(unknown_name("callsign", "AC1", [])) == "unknown callsign 'AC1' (allowed: none)"


def test_names_the_first_unknown_name():
    check_known("fix", [], {})
    check_known("fix", ["EGL", "ALB"], {"EGL": 1, "ALB": 2})
    with pytest.raises(InputError, match=r"^unknown fix 'ALBA'; did you mean 'ALB'"):
        check_known("fix", ["EGL", "ALBA", "XYZ"], ["EGL", "ALB"])


def test_suggests_the_only_name_that_starts_with_what_was_typed():
    names = ["testScenario", "Test_Scenario_8_15Aircraft_Hard", "Test_Scenario_7_5Aircraft_Easy"]
    assert "did you mean 'Test_Scenario_8_15Air" in str(
        unknown_name("it", "Test_Scenario_8", names)
    )
    assert "did you mean" not in str(unknown_name("it", "", ["one"]))


def test_reports_a_name_too_long_for_a_path_as_unknown():
    for name in ("x" * 300, "\u00e9" * 190):
        error = unknown_name("sector", name, ["merge"], [f"{name}.json"])
        assert str(error).endswith("(allowed: merge)")


@pytest.mark.parametrize("kind", [int, np.int8, np.uint64, np.array, torch.tensor])
def test_converts_integers_of_any_library_to_int(kind):
    number = checked_integer("it", kind(3), 3, 3)
    assert (number, type(number)) == (3, int)


@pytest.mark.parametrize("flag", [True, np.True_, np.array(True), torch.tensor(True)])
def test_rejects_booleans(flag):
    with pytest.raises(InputError, match=r"^it is .*\(allowed: whole numbers from 0\)$"):
        checked_integer("it", flag, 0)


@pytest.mark.parametrize("value", [-1, 6, 1.0, "1", None, np.array([1, 2]), np.float32(1)])
def test_rejects_other_values(value):
    with pytest.raises(InputError, match=r"\(allowed: whole numbers from 0 to 5\)$"):
        checked_integer("it", value, 0, 5)
