"""Messages stay one printable line, whatever names a stranger's file holds."""

from skystack.errors import LONGEST_LINE, InputError, unknown_name


def test_a_message_is_one_printable_line():
    assert str(InputError("a\nb\x1b[31m\ud800é")) == "a\\nb\\x1b[31m\\ud800é"


def test_a_long_message_is_cut():
    assert str(InputError("x" * 1_000_000)) == "x" * LONGEST_LINE + "..."


def test_no_nearest_name_is_sought_among_very_many():
    names = [f"FIX{number}" for number in range(200_000)]
    assert "did you mean" not in str(unknown_name("fix", "FIX200000", names))


def test_a_name_too_long_for_a_file_is_unknown_like_any_other():
    for name in ("x" * 300, "\u00e9" * 190):
        error = unknown_name("sector", name, ["merge"], [f"{name}.json"])
        assert str(error).endswith("(allowed: merge)")
