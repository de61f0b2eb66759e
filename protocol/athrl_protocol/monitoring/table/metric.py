"""A row of the table of metrics, and rows that belong together."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

_PLACEHOLDER = re.compile(r"[A-Z]+")


@dataclass(frozen=True)
class Metric:
    """One metric of a service.

    Attributes:
        name: as the service reports it and TensorBoard shows it; empty if only the endpoint has it.
        exposed: its name in Prometheus, behind the prefix of its group.
        meaning: one sentence, with the unit where the name has none.
    """

    name: str
    exposed: str
    meaning: str

    @property
    def counts(self) -> bool:
        """Whether it only grows, but for restarts."""
        return self.exposed.endswith("_total")

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the labels for the parts of the name that vary."""
        return tuple(part.lower() for part in self.name.split("/") if _PLACEHOLDER.fullmatch(part))

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """Matches the names that a service reports; its groups are the labels."""
        parts = (
            f"(?P<{part.lower()}>[^/]+)" if _PLACEHOLDER.fullmatch(part) else re.escape(part)
            for part in self.name.split("/")
        )
        return re.compile("/".join(parts))


@dataclass(frozen=True)
class Group:
    """Metrics that belong together.

    Attributes:
        key: names the group in the reference page.
        prefix: of the names in Prometheus; those of one service have the same.
        metrics: in the order of the reference page.
    """

    key: str
    prefix: str
    metrics: tuple[Metric, ...]
