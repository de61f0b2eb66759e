"""Samples per insert: how often a transition is trained on, which couples actors and learner.

The idea is Reverb's rate limiter with two error bounds. `surplus` is the number of samples that are still
due for the inserts so far:

    surplus = ratio * (inserts - minimum_inserts) - samples

Inserting raises it, sampling lowers it, and it is kept within +-`error_bound`: an insert that would push
it above waits (the learner lags), a sample that would push it below waits (the actors lag). The first
`minimum_inserts` transitions are a warm-up: no samples are due for them, and none is permitted before them.

The bound is never smaller than one insert and one sample together. So at least one side may always
continue: if both were refused, the band would be narrower than one insert plus one sample.

A learner that was killed restores the experience after its newest checkpoint, and owes all training on it.
If the bound applied at once, the actors would wait until that is trained, maybe for minutes. So what is owed
beyond the bound becomes arrears: the bound is wider by the arrears and by one insert. Half of the samples
then pay off the arrears, the other half are for new experience.

A run may be resumed with a smaller ratio or a longer warm-up. By these its training leads by all that it has
sampled more, maybe by as much as the rest of the run is due. So a lead beyond the bound is not counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

#: Share of the samples that pays off arrears while there are any.
_FOR_ARREARS = 0.5


class SamplesPerInsert:
    """Permits inserts and samples so that their ratio stays near the target. Not thread-safe."""

    def __init__(
        self,
        *,
        ratio: float,
        tolerance: float,
        minimum_inserts: int,
        largest_insert: int,
        largest_sample: int,
    ) -> None:
        """Make a limiter without any inserts and samples.

        Args:
            ratio: samples of a transition for each transition inserted, > 0.
            tolerance: share of the samples due at the end of the warm-up by which either side may lead.
            minimum_inserts: transitions before the first sample, >= 1.
            largest_insert: transitions of the largest insert, >= 1.
            largest_sample: transitions of the largest sample, >= 1.

        Raises:
            ValueError: an argument is outside its bounds.
        """
        if ratio <= 0 or tolerance < 0:
            raise ValueError(f"ratio must be above and tolerance not below 0, not {ratio} and {tolerance}")
        if min(minimum_inserts, largest_insert, largest_sample) < 1:
            raise ValueError("minimum_inserts, largest_insert and largest_sample must be at least 1")
        self.ratio = ratio
        self.minimum_inserts = minimum_inserts
        self.largest_insert = largest_insert
        self.largest_sample = largest_sample
        self.error_bound = max(tolerance * ratio * minimum_inserts, ratio * largest_insert + largest_sample)
        self.inserts = 0
        self.samples = 0
        self.arrears = 0.0  # samples owed since a restart, by which the surplus may exceed its bound
        self.forgiven = 0.0  # samples that were taken under other settings, and are not counted
        self.closed = False

    @property
    def surplus(self) -> float:
        """Samples due for the inserts so far, minus those taken; negative while samples lead."""
        return self.ratio * (self.inserts - self.minimum_inserts) - self.samples + self.forgiven

    @property
    def warmed_up(self) -> bool:
        """Whether there are enough inserts for training to start."""
        return self.inserts >= self.minimum_inserts

    @property
    def realised_ratio(self) -> float:
        """Samples for each insert after the warm-up so far; 0 before the first."""
        return self.samples / max(1, self.inserts - self.minimum_inserts) if self.warmed_up else 0.0

    def permits_insert(self, count: int) -> bool:
        """Whether `count` more transitions may be inserted now."""
        return not self.closed and self.surplus + self.ratio * count <= self.error_bound + self.arrears

    def permits_sample(self, count: int) -> bool:
        """Whether `count` more transitions may be sampled now.

        After `close` only owed samples are permitted: no more inserts will come.
        """
        lowest = 0.0 if self.closed else -self.error_bound
        return self.warmed_up and self.surplus - count >= lowest

    def owes(self, count: int) -> bool:
        """Whether `count` or more samples are due; a caller that takes only these never leads."""
        return self.warmed_up and self.surplus >= count

    def inserted(self, count: int) -> None:
        """Count `count` inserted transitions."""
        self.inserts += count

    def sampled(self, count: int) -> None:
        """Count `count` sampled transitions."""
        self.samples += count
        self.arrears = max(0.0, self.arrears - _FOR_ARREARS * count)

    def resume(self) -> None:
        """Turn samples that are owed beyond the bound into arrears; called after a restart.

        One more insert is permitted at once, so that no actor waits until training has made room for it. A
        lead beyond the bound is forgiven: only other settings than before can have made it.
        """
        due = self.ratio * max(0, self.inserts - self.minimum_inserts)
        lead = self.samples - self.forgiven - due
        if lead > self.error_bound:
            self.forgiven += lead
        self.arrears = max(0.0, self.surplus + self.ratio * self.largest_insert - self.error_bound)

    def close(self) -> None:
        """No more inserts will come; sampling may continue until nothing is owed."""
        self.closed = True

    def explain(self) -> str:
        """Which side waits for the other now, and why; empty while both may continue."""
        may_insert = self.permits_insert(self.largest_insert)
        may_sample = self.permits_sample(self.largest_sample)
        if self.closed:
            owed = max(0, round(self.surplus))
            return f"all experience has arrived; {owed} samples are still owed" if may_sample else ""
        if not self.warmed_up:
            return f"the learner waits for the warm-up: {self.inserts} of {self.minimum_inserts} transitions"
        if not may_sample:
            return f"the learner waits for data: {self.ratio_text()}"
        if not may_insert:
            return f"the actors wait for the learner: {self.ratio_text()}"
        return ""

    def ratio_text(self) -> str:
        """The realised ratio and its target, in words."""
        return f"{self.realised_ratio:.1f} samples per insert, {self.ratio:g} wanted"

    def state(self) -> dict[str, float]:
        """The counts, for a checkpoint. The bounds come from the run file."""
        counts: dict[str, float] = {"inserts": self.inserts, "samples": self.samples}
        if self.forgiven:
            counts |= {"forgiven": self.forgiven, "ratio": self.ratio, "minimum": self.minimum_inserts}
        return counts

    def load_state(self, state: Mapping[str, float]) -> None:
        """Continue from the counts of `state()`; what was forgiven counts again if the settings have changed.

        Raises:
            ValueError: a count is missing or no integer >= 0, or what was forgiven is no number >= 0.
        """
        counts = {name: state.get(name) for name in ("inserts", "samples")}
        for name, count in counts.items():
            if not isinstance(count, int) or isinstance(count, bool) or count < 0:
                raise ValueError(f"the limiter's {name} must be an integer >= 0, not {count!r}")
        forgiven = state.get("forgiven", 0.0)
        if not isinstance(forgiven, int | float) or not 0 <= forgiven < math.inf:
            raise ValueError(f"the limiter's forgiven must be a number >= 0, not {forgiven!r}")
        self.inserts, self.samples = int(state["inserts"]), int(state["samples"])
        same = (state.get("ratio"), state.get("minimum")) == (self.ratio, self.minimum_inserts)
        self.forgiven = float(forgiven) if same else 0.0
