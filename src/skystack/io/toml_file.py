"""Strict reading of untrusted TOML: errors are one line."""

import tomllib
from typing import Any

from skystack.errors import InputError
from skystack.io.json_file import check_plain, parser_limit_error, with_whole_numbers


def parse_toml(data: bytes) -> dict[str, Any]:
    """The values of a TOML file: tables, lists, text, finite numbers, true and false.

    Raises InputError for invalid TOML, nesting too deep, or a number too long.
    """
    try:
        values = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML ({error})") from None
    except (ValueError, RecursionError) as error:  # numbers of over 4,300 digits
        raise parser_limit_error(error) from None
    check_plain(values)
    whole: dict[str, Any] = with_whole_numbers(values)
    return whole
