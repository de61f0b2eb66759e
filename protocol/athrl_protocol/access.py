"""Who may do what in a run: the access list of a learner or a router, by the common name of a certificate.

The learner's session routes everything. A router between it and some clients has a list of its own for those;
the learner lets it do whatever clients may do together, and cannot tell them apart. Zenoh looks at every
message twice: when a client's comes in (`ingress`) and before one goes out to a client (`egress`). A rule
allows kinds of messages in one direction on some keys, and what no rule allows is dropped. The key of a rule
must include the key of the message: a client that asks for more than it may have, such as `athrl/**`, gets
nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from athrl_protocol.certificates import ROLES
from athrl_protocol.keys import EVERY_RUN_FILE, Keys


class Rule(NamedTuple):
    """Kinds of messages that are allowed in one direction on some keys."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]

    def seen_from_the_other_end(self) -> Rule:
        """Return the rule of the other end of the link, whose outgoing messages come in here."""
        return self._replace(flow={"ingress": "egress", "egress": "ingress"}[self.flow])


CLIENTS = ("actor", "evaluator", "viewer")
ONLOOKERS = ("viewer", "learner", "router")
"""Whose certificates let see all of a run: its metrics and evaluations."""


def access_list(run: str) -> dict[str, Any]:
    """Return Zenoh's `access_control` for the learner of a run: each role may do its part, others nothing."""
    keys = Keys(run)
    rules = {role: _rules_of(role, keys) for role in ROLES if role != "router"}
    return _configuration({**rules, "router": [*_rules_of_clients(keys), *_shows_itself("router", keys)]})


def access_list_of_router(run: str) -> dict[str, Any]:
    """Return the same for a router: clients may do their part, the learner the other half of that."""
    keys = Keys(run)
    rules = {role: _rules_of(role, keys) for role in CLIENTS}
    towards_learner = [*_rules_of_clients(keys), *_shows_itself("router", keys)]
    return _configuration({**rules, "learner": [rule.seen_from_the_other_end() for rule in towards_learner]})


def _configuration(rules: dict[str, list[Rule]]) -> dict[str, Any]:
    """Put the rules of each role into Zenoh's words."""
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{role}-{number}",
                "permission": "allow",
                "flows": [rule.flow],
                "messages": list(rule.messages),
                "key_exprs": list(rule.keys),
            }
            for role, of_role in rules.items()
            for number, rule in enumerate(of_role)
        ],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in rules],
        "policies": [
            {"rules": [f"{role}-{number}" for number in range(len(of_role))], "subjects": [role]}
            for role, of_role in rules.items()
        ],
    }


def _rules_of(role: str, keys: Keys) -> list[Rule]:
    if role == "actor":
        return [
            *_reads_newest(keys.policy, keys.state),
            *_joins(role, keys),
            *_puts(keys.metrics_of(role), keys.live_of(role), seen_by=(keys.every_metrics, keys.every_live)),
            Rule("ingress", ("query",), (keys.every_experience,)),
            Rule("egress", ("reply", "declare_queryable"), (keys.every_experience,)),
        ]
    if role == "evaluator":
        return [
            *_reads_newest(keys.policy, keys.state),
            *_joins(role, keys),
            *_puts(keys.metrics_of(role), keys.live_of(role), seen_by=(keys.every_metrics, keys.every_live)),
            *_listens(keys.every_metrics),
            *_publishes_newest(keys.every_evaluation),
        ]
    # Viewers, and the learner's own certificate where somebody on its machine looks at the run.
    return [
        *_reads_newest(keys.state, keys.every_evaluation),
        *_reads_run_file(keys),
        *_sees_presence(keys),
        *_listens(keys.every_metrics, keys.every_live),
    ]


def _rules_of_clients(keys: Keys) -> list[Rule]:
    return [rule for role in CLIENTS for rule in _rules_of(role, keys)]


def _joins(role: str, keys: Keys) -> list[Rule]:
    """What a service does to take part: it reads the run file, sees who is there, and shows itself."""
    return [*_reads_run_file(keys), *_sees_presence(keys), *_shows_itself(role, keys)]


def _shows_itself(role: str, keys: Keys) -> list[Rule]:
    return [Rule("ingress", ("liveliness_token",), (keys.alive_of(role),))]


def _reads_run_file(keys: Keys) -> list[Rule]:
    # Whoever knows no run's name asks for every run's file.
    return [
        Rule("ingress", ("query",), (EVERY_RUN_FILE, keys.run_file)),
        Rule("egress", ("reply", "declare_queryable"), (keys.run_file,)),
    ]


def _sees_presence(keys: Keys) -> list[Rule]:
    return [
        Rule("ingress", ("liveliness_query", "declare_liveliness_subscriber"), (keys.every_alive,)),
        Rule("egress", ("liveliness_token",), (keys.every_alive,)),
    ]


def _reads_newest(*keys: str) -> list[Rule]:
    """A subscriber to the newest value, which asks every publisher that shows."""
    asks = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
    return [
        Rule("ingress", asks, keys),
        Rule("egress", ("put", "reply", "liveliness_token", "declare_queryable"), keys),
    ]


def _publishes_newest(*keys: str) -> list[Rule]:
    return [
        Rule("ingress", ("put", "reply", "liveliness_token", "declare_queryable"), keys),
        Rule("egress", ("query", "declare_subscriber"), keys),
    ]


def _puts(*keys: str, seen_by: tuple[str, ...]) -> list[Rule]:
    """A publisher of its own keys; it sends only if it has heard of a subscriber, whose key may be wider."""
    return [Rule("ingress", ("put",), keys), Rule("egress", ("declare_subscriber",), seen_by)]


def _listens(*keys: str) -> list[Rule]:
    return [Rule("ingress", ("declare_subscriber",), keys), Rule("egress", ("put",), keys)]
