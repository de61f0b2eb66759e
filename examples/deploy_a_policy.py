"""Drive with a policy's ONNX file and nothing of athrl: `python examples/deploy_a_policy.py POLICY.onnx`.

It needs numpy and onnxruntime. The file says itself what it sees and what it decides.
"""

import json
import os
import sys

import numpy as np

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # before the import, which starts to report to its maker
import onnxruntime

if len(sys.argv) != 2:
    sys.exit("usage: deploy_a_policy.py POLICY.onnx")
session = onnxruntime.InferenceSession(sys.argv[1])
about = json.loads(session.get_modelmeta().custom_metadata_map["athrl"])
outputs = [output.name for output in session.get_outputs()]
inputs = {"image": np.uint8, "motion": np.float32}

# Of each level: what it remembers (zeros at the start), no exploration, nothing forced.
feed = {
    entry.name: np.full(
        [1, *entry.shape[1:]],
        np.nan if entry.name.startswith("forced_") else 0,
        inputs.get(entry.name, np.float32),
    )
    for entry in session.get_inputs()
}
for _ in range(3):  # every 0.4 s: put the bird's eye view and the motion in, take the decision out
    feed["image"][0, :, 12:20, 0] = 255  # a straight road
    feed["motion"][0] = (5.0 / 8.0, 0.0)  # 5 m/s, straight on
    decided = dict(zip(outputs, session.run(outputs, feed), strict=True))
    feed.update(
        {name.removeprefix("next_"): value for name, value in decided.items() if name.startswith("next_")}
    )

for level in about["levels"]:
    values = zip(level["actions"], decided[level["name"]][0], strict=True)
    print(
        level["name"], {action["name"]: f"{value:.3f} {action['unit']}".strip() for action, value in values}
    )
