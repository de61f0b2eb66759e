"""Checks that answers arrive over an open connection, and reconnects if not.

Zenoh 1.10 may delete a lost connection twice, when both writing to it and reading from it fail
(`TransportUnicastUniversal.delete`), and it does so by the other side's name. If the other side has connected
again by then, the new connection is removed from the list for sending. It is kept alive and messages are
received, but none is sent, and neither side notices. This was seen after a pause longer than the lease. Or a
learner removes a router's connection from its routes while it is open
(https://github.com/eclipse-zenoh/zenoh/issues/1886).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable

import zenoh

from athrl_protocol.messages.keys import PROBE_RUN_FILE, Keys
from athrl_protocol.transport.address import split_address
from athrl_protocol.transport.socket_options import shut_down

QUERY_INTERVAL_SECONDS = 2.0
"""Between two queries; the first is sent as soon as there is a connection."""
RETRY_SECONDS = 0.5
"""Between queries without an answer."""
STALLED_SECONDS = 1.0
"""Between two polls: this process was stalled, and that time does not count as waiting."""
LONGEST_PATIENCE = 60.0

log = logging.getLogger(__name__)


class Reconnection:
    """Queries the other side of a session's connection regularly, and gives up a connection without answers.

    Zenoh then connects again. The patience for an answer doubles after each missing one, and is four times
    the duration of the last answer, as the other side or the network may just be slow. Queries have priority
    over all other messages.

    Args:
        session: an open session, which stays the caller's.
        address: the address of the other side.
        run: for a router: the run whose learner must answer. Without it, the other side itself answers that
            there is no such value, whether a learner is behind it or not.
        patience: seconds to wait for the first answer.
    """

    def __init__(
        self, session: zenoh.Session, address: str, run: str | None = None, patience: float = 3.0
    ) -> None:
        self._session = session
        self._address = address
        self._query_key = PROBE_RUN_FILE if run is None else Keys(run).run_file
        self._needs_answer = run is not None
        self._least_patience = self._patience = patience
        self._replies: zenoh.handlers.Handler[zenoh.Reply] | None = None
        self._queried_at = 0.0
        self._query_at = time.monotonic()
        self._unanswered_since: float | None = None
        self._polled_at = time.monotonic()

    def handle_events(self, events: Iterable[zenoh.LinkEvent]) -> None:
        """Query at once over a new connection to the other side; connections of clients are ignored."""
        made = (event.link for event in events if event.kind == zenoh.SampleKind.PUT)
        if any(self._is_to_other_side(link) for link in made):
            self._reset(time.monotonic())

    def poll(self) -> None:
        """Query, read answers or reconnect, without waiting; called a few times a second."""
        now = time.monotonic()
        if now - self._polled_at > STALLED_SECONDS and self._unanswered_since is not None:
            self._unanswered_since += now - self._polled_at
        self._polled_at = now
        if self._replies is not None:
            self._read_replies(now)
        if self._unanswered_since is not None and now - self._unanswered_since > self._patience:
            self._reconnect(now)
        elif self._replies is None and now >= self._query_at:
            self._send_query(now)

    def _send_query(self, now: float) -> None:
        if not self._links_to_other_side():
            self._reset(now)  # Zenoh is connecting; start again once there is a connection
            return
        self._queried_at = now
        if self._unanswered_since is None:
            self._unanswered_since = now
        self._replies = self._session.get(
            self._query_key,
            timeout=2 * LONGEST_PATIENCE,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def _read_replies(self, now: float) -> None:
        """Read the answers, and then their end."""
        assert self._replies is not None
        answered = False
        try:
            while (reply := self._replies.try_recv()) is not None:
                answered = answered or reply.ok is not None
        except zenoh.ZError:
            answered = answered or not self._needs_answer
            self._replies, self._query_at = None, now + RETRY_SECONDS
        if answered:
            self._replies, self._unanswered_since, self._query_at = None, None, now + QUERY_INTERVAL_SECONDS
            self._patience = min(LONGEST_PATIENCE, max(self._least_patience, 4 * (now - self._queried_at)))

    def _reconnect(self, now: float) -> None:
        links = self._links_to_other_side()
        if links:
            log.warning("%s is connected and does not answer: reconnecting", self._address)
            shut_down(links)
            self._patience = min(LONGEST_PATIENCE, 2 * self._patience)
        self._reset(now)

    def _reset(self, now: float) -> None:
        """Start again with the next poll."""
        self._replies, self._unanswered_since, self._query_at = None, None, now

    def _links_to_other_side(self) -> list[zenoh.Link]:
        """The connections to the other side."""
        info = self._session.info
        others = {str(zid) for zid in info.routers_zid()}
        return [link for link in info.links() if str(link.zid) in others and self._is_to_other_side(link)]

    def _is_to_other_side(self, link: zenoh.Link) -> bool:
        return split_address(str(link.dst))[1] == split_address(self._address)[1]
