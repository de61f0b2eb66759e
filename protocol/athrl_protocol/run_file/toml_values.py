"""Values of settings as TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from datetime import date, time
from typing import Any

from athrl_spaces.untrusted import one_line

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def to_toml_value(value: Any) -> str:
    """Return a number, text, truth value, date, list or table as TOML, in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # TOML's strings are JSON's, except for this character, which TOML requires to be escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        pairs = [f"{_key(key)} = {to_toml_value(entry)}" for key, entry in value.items()]
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(to_toml_value(entry) for entry in value)}]"
    if isinstance(value, date | time):
        return value.isoformat()
    return repr(value)


def choice(values: Iterable[Any]) -> str:
    """Return alternatives in words: `"a", "b" or "c"`."""
    *others, last = [to_toml_value(value) for value in values]
    return f"{', '.join(others)} or {last}" if others else last


def show(value: Any) -> str:
    """Return a value for a message: as TOML, in one line, shortened if it is long."""
    return cut(to_toml_value(value))


def cut(text: str) -> str:
    """Return a text for a message: in one line, shortened if it is long."""
    return one_line(text if len(text) <= 60 else f"{text[:57]}...")


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else to_toml_value(key)
