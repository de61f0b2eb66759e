"""Read a recorded episode with nothing of athrl: `python examples/read_a_recording.py EPISODE.mcap`.

It needs mcap and mcap-protobuf-support. The file brings the schemas of its messages along.
"""

import sys

from mcap_protobuf.reader import read_protobuf_messages

if len(sys.argv) < 2:
    sys.exit("usage: read_a_recording.py EPISODE.mcap")
speeds, total = [], 0.0
for message in read_protobuf_messages(sys.argv[1], topics=["/frame"]):
    frame = message.proto_msg
    speeds.append(frame.ego.speed)
    total += frame.reward

print("fields of a frame:", ", ".join(field.name for field in frame.DESCRIPTOR.fields))
print(f"{len(speeds)} frames, mean speed {sum(speeds) / len(speeds):.2f} m/s, return {total:.0f}")
