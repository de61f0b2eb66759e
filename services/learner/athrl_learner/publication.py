"""Publication of policies: when, with which version, and with how much noise."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path

from athrl_planners import PolicyExporter
from athrl_protocol import PolicyUpdate
from athrl_spaces.policy import LARGEST_ARTEFACT
from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_json
from athrl_spaces.wording import system_reason

from athrl_learner.errors import WrongPlanner
from athrl_learner.files import Files, write_whole
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.log import count_of
from athrl_learner.log.segments import LARGEST_NUMBER
from athrl_learner.run_folder import RunFolder


def annealed_noise(environment_steps: int, target: int, final_scale: float) -> float:
    """Factor on the exploration noise: falls linearly from 1 to `final_scale` over `target` steps."""
    return 1.0 + (final_scale - 1.0) * min(1.0, environment_steps / target)


def recorded_version(facts: Path) -> int:
    """The newest version that was published according to `policies/latest.json`; -1 if unknown.

    A learner that was killed resumes from a checkpoint older than its last publication. It must not repeat
    versions that actors already have, or they would consider the new policies old.
    """
    try:
        with parser_errors(UntrustedFile):
            version = count_of(read_json(facts)["version"])
            return version if version <= LARGEST_NUMBER else -1
    except UntrustedFile:
        return -1


def require_accepted(artefact: bytes, kind: str) -> None:
    """Refuse a planner whose policy every actor and evaluator would refuse, before anything is trained.

    Raises:
        WrongPlanner: its file is larger than they accept.
    """
    if len(artefact) > LARGEST_ARTEFACT:
        raise WrongPlanner(
            f"planner.kind = {kind}: its policy has {len(artefact) / 2**20:,.0f} MiB, more than the "
            f"{LARGEST_ARTEFACT / 2**20:,.0f} that actors accept: set the widths of its layers to less"
        )


class Publication:
    """Publishes the averaged networks: `deliver` sends them; also written as `policies/latest.onnx`."""

    def __init__(
        self,
        deliver: Callable[[PolicyUpdate], object],
        exporter: PolicyExporter,
        folder: RunFolder,
        arrivals: Arrivals,
        *,
        seconds: float,
        final_noise_scale: float,
        environment_steps_target: int,
        warn: Callable[[str], object],
    ) -> None:
        """`warn` is called with a text when the policy's files cannot be written."""
        self.version = -1  # of the newest published policy
        self.noise_scale = 1.0  # of that policy
        self._deliver = deliver
        self._exporter = exporter
        self._folder = folder
        self._arrivals = arrivals
        self._seconds = seconds
        self._final_noise_scale = final_noise_scale
        self._target = environment_steps_target
        self._warn = warn
        self._published_at = -seconds
        self._published_updates = -1

    def resume_from(self, version: int) -> None:
        """Set the newest published version; the next one is above it."""
        self.version = version
        self._arrivals.published_version = version

    def due(self, updates: int) -> bool:
        """Whether there was an update and enough time since the last publication."""
        return updates != self._published_updates and time.monotonic() - self._published_at >= self._seconds

    def publish(self, *, updates: int, environment_steps: int, uniform_exploration: bool) -> None:
        """Publish the current weights with the next version.

        The files are written first, so the run's folder knows every version that an actor has.
        """
        update = PolicyUpdate(
            version=self.version + 1,
            artefact=self._exporter.artefact(),
            uniform_exploration=uniform_exploration,
            noise_scale=annealed_noise(environment_steps, self._target, self._final_noise_scale),
            updates=updates,
            environment_steps=environment_steps,
            published_at=time.time(),
        )
        self._write_files(update)
        self._arrivals.published(update.version)  # before an actor can have it
        self._deliver(update)
        self.version, self.noise_scale = update.version, update.noise_scale
        self._published_at = time.monotonic()
        self._published_updates = updates

    def _write_files(self, update: PolicyUpdate) -> None:
        facts = {
            "version": update.version,
            "updates": update.updates,
            "environment_steps": update.environment_steps,
            "sha256": hashlib.sha256(update.artefact).hexdigest(),
        }
        try:
            write_whole(Files(), self._folder.latest_policy_facts, json.dumps(facts, indent=1).encode())
            write_whole(Files(), self._folder.latest_policy, update.artefact)
        except OSError as error:
            self._warn(f"cannot write {self._folder.latest_policy}: {system_reason(error)}")
