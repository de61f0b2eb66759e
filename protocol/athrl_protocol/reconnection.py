"""Looks whether anything comes back over a connection that stands, and connects anew if not.

Zenoh 1.10 may clear a lost connection away twice, when writing to it fails as well as reading
(`TransportUnicastUniversal.delete`), and it does so by the other side's name: if that one has connected anew
meanwhile, it is the new connection that is taken from the list of those to send over. It is kept alive, what
comes is received, and never is anything sent: neither side would notice. It was seen where somebody had been
paused for longer than the lease. Or a learner takes a router's connection out of its routes while it stands
(https://github.com/eclipse-zenoh/zenoh/issues/1886).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable

import zenoh

from athrl_protocol.address import split_address
from athrl_protocol.keys import NOBODYS_RUN_FILE, Keys
from athrl_protocol.socket_options import shut_down

ASK_SECONDS = 2.0
"""Between two questions; the first comes at once when a connection was made."""
AGAIN_SECONDS = 0.5
"""Between questions to which there was no answer."""
FALTERED_SECONDS = 1.0
"""Without a look: this process stood still, and no answer can be missed for that time."""
LONGEST_PATIENCE = 60.0

log = logging.getLogger(__name__)


class Reconnection:
    """Asks the other side of a session's connection now and then, and gives up one that brings no answer.

    Zenoh makes another one by itself. An answer is waited for twice as long after each one that did not come,
    and four times as long as the last one took, as the other side or the network may just be slow. Questions
    go before everything else that is to be sent.

    Args:
        session: which stays the caller's.
        address: to which it is connected.
        run: whose learner must answer, for a router, which knows by itself that nobody has an answer; without
            it the other side says that there is none, whether a learner is behind it or not.
        patience: seconds for which the first answer is waited for.
    """

    def __init__(
        self, session: zenoh.Session, address: str, run: str | None = None, patience: float = 3.0
    ) -> None:
        self._session = session
        self._address = address
        self._question = NOBODYS_RUN_FILE if run is None else Keys(run).run_file
        self._has_answer = run is not None
        self._least_patience = self._patience = patience
        self._replies: zenoh.handlers.Handler[zenoh.Reply] | None = None
        self._asked_at = 0.0
        self._ask_at = time.monotonic()
        self._unanswered_since: float | None = None
        self._looked_at = time.monotonic()

    def hear(self, events: Iterable[zenoh.LinkEvent]) -> None:
        """Ask at once over a new connection to the other side; those that others make are none of it."""
        made = (event.link for event in events if event.kind == zenoh.SampleKind.PUT)
        if any(self._is_to_other_side(link) for link in made):
            self._forget(time.monotonic())

    def look(self) -> None:
        """Do what has to be done, without waiting for anything; call it a few times a second."""
        now = time.monotonic()
        if now - self._looked_at > FALTERED_SECONDS and self._unanswered_since is not None:
            self._unanswered_since += now - self._looked_at
        self._looked_at = now
        if self._replies is not None:
            self._hear(now)
        if self._unanswered_since is not None and now - self._unanswered_since > self._patience:
            self._connect_anew(now)
        elif self._replies is None and now >= self._ask_at:
            self._ask(now)

    def _ask(self, now: float) -> None:
        if not self._links():
            self._forget(now)  # Zenoh is connecting; another one is looked at when it stands
            return
        self._asked_at = now
        if self._unanswered_since is None:
            self._unanswered_since = now
        self._replies = self._session.get(
            self._question,
            timeout=2 * LONGEST_PATIENCE,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def _hear(self, now: float) -> None:
        """See what has come: answers, and then the end of them."""
        assert self._replies is not None
        answered = False
        try:
            while (reply := self._replies.try_recv()) is not None:
                answered = answered or reply.ok is not None
        except zenoh.ZError:
            answered = answered or not self._has_answer
            self._replies, self._ask_at = None, now + AGAIN_SECONDS
        if answered:
            self._replies, self._unanswered_since, self._ask_at = None, None, now + ASK_SECONDS
            self._patience = min(LONGEST_PATIENCE, max(self._least_patience, 4 * (now - self._asked_at)))

    def _connect_anew(self, now: float) -> None:
        links = self._links()
        if links:
            log.warning("%s is connected and does not answer: connecting anew", self._address)
            shut_down(links)
            self._patience = min(LONGEST_PATIENCE, 2 * self._patience)
        self._forget(now)

    def _forget(self, now: float) -> None:
        """Begin again with the next look."""
        self._replies, self._unanswered_since, self._ask_at = None, None, now

    def _links(self) -> list[zenoh.Link]:
        """The connections to the other side."""
        info = self._session.info
        others = {str(zid) for zid in info.routers_zid()}
        return [link for link in info.links() if str(link.zid) in others and self._is_to_other_side(link)]

    def _is_to_other_side(self, link: zenoh.Link) -> bool:
        return split_address(str(link.dst))[1] == split_address(self._address)[1]
