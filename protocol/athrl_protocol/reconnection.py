"""A router that connects anew to a learner which is there and which nothing reaches.

When a router or its learner was paused for about as long as the lease, the learner now and then takes the
router's new connection for the old one and clears it away from its routes while it stands
(https://github.com/eclipse-zenoh/zenoh/issues/1886). Neither of the two would ever notice.
"""

from __future__ import annotations

import logging
import time

import zenoh

from athrl_protocol.address import split_address
from athrl_protocol.announcements import is_run_file_served
from athrl_protocol.socket_options import shut_down

SILENT_SECONDS = 1.5
"""Without the state that a learner tells each second, until it is asked."""
ANSWER_SECONDS, LONGEST_ANSWER_SECONDS = 1.5, 6.0
"""For which its answer is waited for; twice as long after each connection in vain, as it may just be slow."""

log = logging.getLogger(__name__)


class Reconnection:
    """Looks whether the learner is heard, asks it if not, and gives up the connection if it does not answer.

    Zenoh makes another one by itself.

    Args:
        session: the router's, which stays the caller's.
        address: of the learner.
        run: its name.
    """

    def __init__(self, session: zenoh.Session, address: str, run: str) -> None:
        self._session = session
        self._address = address
        self._run = run
        self._heard_at = time.monotonic()
        self._patience = ANSWER_SECONDS

    def hear(self, _: object) -> None:
        """The learner has told something."""
        self._heard_at = time.monotonic()
        self._patience = ANSWER_SECONDS

    def look(self) -> None:
        """Do what has to be done; takes `LONGEST_ANSWER_SECONDS` at most."""
        links = self._links()
        if links and time.monotonic() - self._heard_at < SILENT_SECONDS:
            return
        if links and not is_run_file_served(self._session, self._run, self._patience):
            log.warning("the learner at %s is connected and does not answer: connecting anew", self._address)
            shut_down(links)
            self._patience = min(2 * self._patience, LONGEST_ANSWER_SECONDS)
        self._heard_at = time.monotonic()

    def _links(self) -> list[zenoh.Link]:
        """The connections to the learner."""
        info, port = self._session.info, split_address(self._address)[1]
        learners = {str(zid) for zid in info.routers_zid()}
        return [
            link
            for link in info.links()
            if str(link.zid) in learners and split_address(str(link.dst))[1] == port
        ]
