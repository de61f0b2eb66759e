"""The access list of a learner or a router: permissions of each role, the common name of a certificate.

A certificate that is bound to an actor's name permits what an actor does under that name alone, and nobody
else may use the name, not even with the certificate of the role actor. All other names are shared by that
role: the list cannot distinguish its actors.

The learner's session routes everything. A router between it and some clients has its own list for these
clients; the learner permits a router everything that any client may do, and cannot distinguish its clients.
Zenoh checks every message twice: when it arrives from a client (`ingress`) and before it is sent to a client
(`egress`). A rule permits kinds of messages in one direction on some keys; everything else is dropped. The
key of a rule must include the key of the message: a client that asks for more than its permissions, such as
`athrl/**`, gets nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from athrl_protocol.messages.keys import EVERY_RUN_FILE, HOST_ROLE, Keys
from athrl_protocol.security.certificates import ROLES, bound_common_name


class Rule(NamedTuple):
    """Kinds of messages that are allowed in one direction on some keys; or denied, which takes precedence."""

    flow: str
    messages: tuple[str, ...]
    keys: tuple[str, ...]
    permission: str = "allow"

    def seen_from_the_other_end(self) -> Rule:
        """Return the rule of the other end of the link, whose outgoing messages arrive here."""
        return self._replace(flow={"ingress": "egress", "egress": "ingress"}[self.flow])


CLIENTS = ("actor", "evaluator", "viewer")
OBSERVERS = ("viewer", "learner", "router")
"""Roles that may see everything of a run: its metrics and evaluations."""


def access_list(run: str, bound_names: Sequence[str] = ()) -> dict[str, Any]:
    """Return Zenoh's `access_control` for the learner of a run: permissions of each role and bound actor."""
    keys = Keys(run)
    rules = {role: _rules_of(role, keys) for role in ROLES if role != "router"}
    router = [*_rules_of_clients(keys), *_shows_itself("router", keys)]
    return _configuration(_with_bound_actors({**rules, "router": router}, bound_names, keys))


def access_list_of_router(run: str, bound_names: Sequence[str] = ()) -> dict[str, Any]:
    """Return the same for a router: permissions of its clients, and the opposite ones of the learner."""
    keys = Keys(run)
    rules = {role: _rules_of(role, keys) for role in CLIENTS}
    towards_learner = [*_rules_of_clients(keys), *_shows_itself("router", keys)]
    learner = [rule.seen_from_the_other_end() for rule in towards_learner]
    return _configuration(_with_bound_actors({**rules, "learner": learner}, bound_names, keys))


def _with_bound_actors(
    rules: dict[str, list[Rule]], bound_names: Sequence[str], keys: Keys
) -> dict[str, list[Rule]]:
    """Add the rules of bound actors, and deny their names to the shared role."""
    if not bound_names:
        return rules
    bound = {bound_common_name(name): _rules_of_bound_actor(name, keys) for name in bound_names}
    own = tuple(key for name in bound_names for key in _own_keys(name, keys))
    denied = Rule("ingress", ("query", "put", "liveliness_token"), own, "deny")
    return {**rules, "actor": [*rules["actor"], denied], **bound}


def _configuration(rules: dict[str, list[Rule]]) -> dict[str, Any]:
    """Convert the rules of each role to Zenoh's configuration."""
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{role}-{number}",
                "permission": rule.permission,
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
            *_shows_itself(HOST_ROLE, keys),
            *_puts(keys.metrics_of(role), keys.live_of(role), seen_by=(keys.every_metrics, keys.every_live)),
            *_asks(keys.every_experience, keys.free_name(role)),
        ]
    if role == "evaluator":
        return [
            *_reads_newest(keys.policy, keys.state),
            *_joins(role, keys),
            *_puts(keys.metrics_of(role), keys.live_of(role), seen_by=(keys.every_metrics, keys.every_live)),
            *_listens(keys.every_metrics),
            *_publishes_newest(keys.every_evaluation),
        ]
    # Viewers, and the learner's own certificate when it is used on its machine to view the run.
    return [
        *_reads_newest(keys.state, keys.every_evaluation),
        *_reads_run_file(keys),
        *_asks(keys.changes),
        *_sees_presence(keys),
        *_listens(keys.every_metrics, keys.every_live),
    ]


def _rules_of_bound_actor(name: str, keys: Keys) -> list[Rule]:
    return [
        *_reads_newest(keys.policy, keys.state),
        *_reads_run_file(keys),
        *_sees_presence(keys),
        *_shows_itself(HOST_ROLE, keys),
        Rule("ingress", ("query", "put", "liveliness_token"), _own_keys(name, keys)),
        # What the learner declares is for all actors; only this one's own query is answered.
        Rule("egress", ("declare_subscriber",), (keys.every_metrics, keys.every_live)),
        Rule("egress", ("reply", "declare_queryable"), (keys.every_experience,)),
    ]


def _own_keys(name: str, keys: Keys) -> tuple[str, ...]:
    """Return the keys under which an actor uploads, reports and shows itself."""
    role = "actor"
    return (
        keys.experience(name),
        keys.metrics(role, name),
        keys.live(role, name),
        keys.alive(role, name),
    )


def _rules_of_clients(keys: Keys) -> list[Rule]:
    return [rule for role in CLIENTS for rule in _rules_of(role, keys)]


def _joins(role: str, keys: Keys) -> list[Rule]:
    """Rules for taking part: read the run file, see present services, announce itself."""
    return [*_reads_run_file(keys), *_sees_presence(keys), *_shows_itself(role, keys)]


def _shows_itself(role: str, keys: Keys) -> list[Rule]:
    return [Rule("ingress", ("liveliness_token",), (keys.alive_of(role),))]


def _reads_run_file(keys: Keys) -> list[Rule]:
    # A client that does not know the name of the run queries the run file of every run.
    return [
        Rule("ingress", ("query",), (EVERY_RUN_FILE, keys.run_file)),
        Rule("egress", ("reply", "declare_queryable"), (keys.run_file,)),
    ]


def _asks(*keys: str) -> list[Rule]:
    """A client that queries the learner, and its answers."""
    return [Rule("ingress", ("query",), keys), Rule("egress", ("reply", "declare_queryable"), keys)]


def _sees_presence(keys: Keys) -> list[Rule]:
    return [
        Rule("ingress", ("liveliness_query", "declare_liveliness_subscriber"), (keys.every_alive,)),
        Rule("egress", ("liveliness_token",), (keys.every_alive,)),
    ]


def _reads_newest(*keys: str) -> list[Rule]:
    """A subscriber to the newest value, which queries every publisher."""
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
    """A publisher of its own keys; it only sends if it knows of a subscriber, whose key may be wider."""
    return [Rule("ingress", ("put",), keys), Rule("egress", ("declare_subscriber",), seen_by)]


def _listens(*keys: str) -> list[Rule]:
    return [Rule("ingress", ("declare_subscriber",), keys), Rule("egress", ("put",), keys)]
