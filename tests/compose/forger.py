"""Takes the newest policy of a run and publishes it as one that is newer, with the certificate that is there.

    python forger.py ADDRESS RUN VERSION

A client that accepted it would ignore the learner's own policies. Started where an actor is.
"""

import sys
import time

from athrl_protocol import Keys, new_incarnation, open_session
from athrl_protocol.announcements.latest_value import LatestPublisher
from athrl_protocol.announcements.typed import TypedSubscriber
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import decode_message, encode_message

PATIENCE = 30.0
TIMES = 20
PAUSE_SECONDS = 0.1


def forge(address: str, run: str, version: int) -> None:
    """Publish the forged policy in the dark, and then as the learner would."""
    key = Keys(run).policy
    with open_session(connect=address, timeout=PATIENCE, role="actor") as session:
        with TypedSubscriber(session, key, bytes) as policies:
            newest = policies.wait(PATIENCE)
        assert newest is not None
        policy = decode_message(athrl_pb2.Policy, newest)
        policy.version = version
        forged = encode_message(policy)
        # Before a publisher is declared: Zenoh then looks for subscribers, and sends nothing without any.
        for _ in range(TIMES):
            edition = athrl_pb2.Version(incarnation=new_incarnation(), number=1)
            session.put(key, forged, attachment=encode_message(edition))
            time.sleep(PAUSE_SECONDS)
        with LatestPublisher(session, key, remind_seconds=PAUSE_SECONDS) as publisher:
            for _ in range(TIMES):
                publisher.publish(forged)
                time.sleep(PAUSE_SECONDS)


if __name__ == "__main__":
    forge(sys.argv[1], sys.argv[2], int(sys.argv[3]))
