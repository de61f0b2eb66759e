"""The tables of the reference page of metrics."""

from __future__ import annotations

import re

from athrl_protocol.monitoring.table import GROUPS, Group, Metric

_BLOCK = re.compile(r"(<!-- table: (?P<key>[a-z ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(page: str) -> str:
    """Return the page with each block between `<!-- table: KEY -->` and `<!-- end -->` as the table says.

    Raises:
        ValueError: a group of the table has no block, or a block no group.
    """
    groups = {group.key: group for group in GROUPS}
    keys = [block["key"] for block in _BLOCK.finditer(page)]
    if sorted(keys) != sorted(groups):
        raise ValueError(f"the page has tables of {sorted(keys)}, should have {sorted(groups)}")
    return _BLOCK.sub(lambda block: f"{block[1]}\n{_table(groups[block['key']])}\n\n{block[3]}", page)


def _table(group: Group) -> str:
    head = ["| metric | in Prometheus | meaning |", "|---|---|---|"]
    rows = [
        f"| `{metric.name}` | `{group.prefix}{metric.exposed}{_labels(metric)}` | {metric.meaning} |"
        for metric in group.metrics
    ]
    return "\n".join([*head, *rows])


def _labels(metric: Metric) -> str:
    return f"{{{','.join(metric.labels)}}}" if metric.labels else ""
