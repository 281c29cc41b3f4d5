"""Faults by name, placed over a run of any length. `annulus twin soak --faults NAME`.

A name is a profile: what may go wrong at any frame, and how often in a million frames the rest happens, at least once
in a run. Where it happens follows from the seed; two of them never fall together, so that what each costs can be told.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.vocabulary import AnnulusError

FIRST = 260  # frames that a run is left alone at first: offset found, clock settled
LAST = 60  # .. and at its end
MILLION = 1_000_000

_DRAWN: Mapping[str, Callable[[np.random.Generator], tuple[str, float | None]]] = {
    # kind of disturbance -> the field it goes into, and how much
    "resets": lambda rng: ("resets", None),
    "power losses": lambda rng: ("power_losses", None),
    "disconnects": lambda rng: ("disconnects", float(rng.choice([60.0, 250.0, 900.0, 3000.0]))),
    "whole steps": lambda rng: ("stamp_steps", float(rng.choice([-7, -5, -3, -2, -1, 1, 2, 3, 5, 7]))),
    "part steps": lambda rng: ("stamp_steps", float(rng.choice([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75]))),
    "half steps": lambda rng: ("stamp_steps", float(rng.choice([-0.5, 0.5]))),
    "five steps": lambda rng: ("stamp_steps", float(rng.choice([-5, 5]))),
    "unplugged": lambda rng: ("unplugged", int(rng.integers(3, 250))),
    "frozen": lambda rng: ("frozen", int(rng.integers(2, 60))),
    "count jumps": lambda rng: ("count_jumps", int(rng.integers(1, 6)) * int(rng.choice([-1, 1]))),
    "count resets": lambda rng: ("count_resets", None),
    "stalls": lambda rng: ("stalls", round(float(rng.uniform(0.1, 4.0)), 3)),
    "long outages": lambda rng: ("disconnects", 60_000.0),
    "unheard restarts": lambda rng: ("disconnects", 60_000.0),  # .. of the controller, in the middle of an outage
    "reckoned jumps": lambda rng: ("stamp_steps", int(rng.choice([-5, 5]))),  # .. and the count's
    "queue steps": lambda rng: ("queue_steps", int(rng.choice([-3, -2, -1, 1, 2, 3]))),
    "queue cycles": lambda rng: ("queue_steps", int(rng.choice([-10, -5, 5, 10]))),
    "pictures behind": lambda rng: ("pictures_behind", int(rng.choice([1, 5]))),
    "hiccups": lambda rng: ("hiccups", int(rng.integers(1, 7))),
    "deeper restarts": lambda rng: ("unplugged", _AWAY),  # and from then on it keeps a lamp cycle more
}
_AWAY = 12  # frames
_UNHEARD = 50  # frames that the line is away before
_ALSO: Mapping[str, Callable[[int, float | None], tuple[str, Any]]] = {  # what comes with it
    "unheard restarts": lambda at, much: ("resets", at + _UNHEARD),
    "reckoned jumps": lambda at, much: ("count_jumps", (at, much)),
    "deeper restarts": lambda at, much: ("queue_steps", (at + _AWAY, 5)),
}


@dataclass(frozen=True, slots=True)
class DisturbanceProfile:
    """Rates, and disturbances a million frames by kind. `thirds`: two resets, a third and two thirds of the way.
    `ratio`: projector flashes to one of the LED.
    """

    says: str
    rates: Faults = NO_FAULTS
    per_million: Mapping[str, float] = field(default_factory=dict)
    thirds: bool = False
    ratio: int = 4

    def place(self, frames: int, seed: int) -> Faults:
        """The faults of a run of so many frames."""
        if self.thirds:
            return replace(self.rates, resets=(frames // 3, 2 * frames // 3))
        rng = np.random.default_rng([seed, 4])
        kinds = [k for k, often in self.per_million.items() for _ in range(max(1, round(often * frames / MILLION)))]
        if not kinds or frames <= FIRST + LAST:
            return self.rates
        rng.shuffle(kinds)
        width = (frames - FIRST - LAST) / len(kinds)
        found: dict[str, Any] = {}
        for i, kind in enumerate(kinds):
            at = FIRST + int(width * (i + rng.uniform(0.0, 0.3)))
            name, much = _DRAWN[kind](rng)
            found.setdefault(name, []).append(at if much is None else (at, much))
            if kind in _ALSO:
                name, value = _ALSO[kind](at, much)
                found.setdefault(name, []).append(value)
        found = {name: tuple(values) for name, values in found.items()}
        return replace(self.rates, **found)


PROFILES = {
    "none": DisturbanceProfile("nothing"),
    "standard": DisturbanceProfile(
        "the line and the driver on a good day, and two restarts of the controller",
        Faults(frames_dropped=0.01, events_lost=0.01, timestamp_jitter_us=2000.0),
        thirds=True,
    ),
    "rough": DisturbanceProfile(
        "a bad line, a noisy sync cable",
        Faults(
            frames_dropped=0.03,
            events_lost=0.02,
            bytes_flipped=1e-4,
            timestamp_jitter_us=3000.0,
            sync_missing=0.003,
            sync_glitches=0.003,
        ),
        thirds=True,
    ),
    "all": DisturbanceProfile(
        "everything",
        Faults(
            frames_dropped=0.01,
            events_lost=0.01,
            bytes_flipped=1e-4,
            timestamp_jitter_us=1000.0,
            frames_late=0.002,
            frames_torn=0.001,
            frames_repeated=0.001,
            stamps_late=0.001,
            stamp_drift_ppm=200.0,
            stamp_drift_turn_s=240.0,
        ),
        {
            "resets": 20,
            "disconnects": 20,
            "whole steps": 20,
            "half steps": 20,
            "part steps": 20,
            "power losses": 20,
            "unplugged": 20,
            "frozen": 20,
            "count jumps": 20,
            "count resets": 20,
            "stalls": 20,
        },
    ),
    "stamp-steps": DisturbanceProfile("stamps move by whole frames", per_million={"whole steps": 400}),
    "five-steps": DisturbanceProfile("stamps move by a whole lamp cycle", per_million={"five steps": 400}),
    "part-steps": DisturbanceProfile(
        "stamps move by a quarter to three quarters of a frame", per_million={"part steps": 400}
    ),
    "stamps-late": DisturbanceProfile(
        "every frame is stamped, and handed over, three frames late", Faults(stamp_offset_frames=3, delivery_frames=3)
    ),
    "stamps-ahead": DisturbanceProfile("every stamp lies three frames in the future", Faults(stamp_offset_frames=3)),
    "one-stamp-late": DisturbanceProfile("one stamp in 37 is late", Faults(stamps_late=1 / 37)),
    "drift": DisturbanceProfile("the stamps' clock runs 200 ppm fast, for ever", Faults(stamp_drift_ppm=200.0)),
    "drift-slow": DisturbanceProfile("the stamps' clock runs 200 ppm slow, for ever", Faults(stamp_drift_ppm=-200.0)),
    "drift-50": DisturbanceProfile("the stamps' clock runs 50 ppm fast, for ever", Faults(stamp_drift_ppm=50.0)),
    "drift-turns": DisturbanceProfile(
        "200 ppm, and its sign changes every four minutes", Faults(stamp_drift_ppm=200.0, stamp_drift_turn_s=240.0)
    ),
    "torn": DisturbanceProfile("one picture in 50 is torn", Faults(frames_torn=0.02)),
    "repeated": DisturbanceProfile("one picture in 50 is the one before", Faults(frames_repeated=0.02)),
    "late": DisturbanceProfile("one frame in 50 is handed over up to half a second late", Faults(frames_late=0.02)),
    "frozen": DisturbanceProfile("the picture stands still", per_million={"frozen": 400}),
    "unplugged": DisturbanceProfile("the camera is taken away and brought back", per_million={"unplugged": 200}),
    "counts": DisturbanceProfile(
        "the driver's count jumps, or begins anew", per_million={"count jumps": 400, "count resets": 200}
    ),
    "stalls": DisturbanceProfile(
        "the host does nothing for a while, then finds old frames", per_million={"stalls": 300}
    ),
    "resets": DisturbanceProfile("the controller restarts", per_million={"resets": 400}),
    "same-boot": DisturbanceProfile(
        "the controller loses power and draws the boot byte it had", per_million={"power losses": 400}
    ),
    "disconnects": DisturbanceProfile(
        "the line to the controller is pulled and plugged", per_million={"disconnects": 300}
    ),
    "winch-at-rest": DisturbanceProfile(
        "the controller restarts, the line is away for a minute, or both; the winch stops with it, or does not",
        per_million={"resets": 200, "long outages": 40, "unheard restarts": 40},
    ),
    "flashes-fail": DisturbanceProfile("one flash in 50 is ordered and does not come", Faults(flashes_failed=0.02)),
    "queue-steps": DisturbanceProfile(
        "the driver keeps one to three frames more, or fewer, and stamps what it hands over",
        per_million={"queue steps": 2000},
    ),
    "queue-cycles": DisturbanceProfile(
        "the driver keeps one or two lamp cycles more, or fewer, and its stamps do not know",
        Faults(timestamp_jitter_us=200.0),
        {"queue cycles": 1000},
    ),
    "queue-cycles-alone": DisturbanceProfile(
        ".. and it does not count, and stamps what it hands over",
        Faults(uncounted=True, stamped_when_handed_over=True),
        {"queue cycles": 1000},
    ),
    "deeper-restarts": DisturbanceProfile(
        "the camera begins anew, its driver keeps a lamp cycle more from then on", per_million={"deeper restarts": 500}
    ),
    "pictures-behind": DisturbanceProfile(
        "pictures of one frame before, or of five more, come with what is said of today's",
        per_million={"pictures behind": 1000},
    ),
    "hiccups": DisturbanceProfile(
        "the driver shows pictures again and blank ones, and those behind are late", per_million={"hiccups": 1000}
    ),
    "hiccups-alone": DisturbanceProfile(
        ".. and loses some, and does not count", Faults(uncounted=True, events_lost=0.01), {"hiccups": 1000}
    ),
    "stamps-odd": DisturbanceProfile("one stamp in ten is off by a frame, by itself", Faults(stamps_odd=0.1)),
    "handed-over": DisturbanceProfile(
        "a driver that does not count stamps what it hands over; one frame in 50 is late",
        Faults(frames_late=0.02, uncounted=True, stamped_when_handed_over=True),
    ),
    "reckoned": DisturbanceProfile(
        "a driver that reckons its stamps from its count moves both by a whole lamp cycle",
        per_million={"reckoned jumps": 1000},
    ),
    "kept-five": DisturbanceProfile("every frame is handed over five frames late", Faults(delivery_frames=5.0)),
    "ratio-0": DisturbanceProfile(
        "stamps move, and there is no LED in the cycle", per_million={"whole steps": 200, "part steps": 200}, ratio=0
    ),
    "ratio-1": DisturbanceProfile(
        "stamps move, and every other flash is the LED's", per_million={"whole steps": 200, "part steps": 200}, ratio=1
    ),
}


def profile_of(source: "Faults | str | Path | None") -> DisturbanceProfile:
    """A profile by name; of faults, or of a TOML file whose keys are the fields of `Faults`, one that is just them."""
    if isinstance(source, Faults):
        return DisturbanceProfile("as given", source)
    if source is not None and str(source) in PROFILES:
        return PROFILES[str(source)]
    return DisturbanceProfile("as given", load_faults(source))


def load_faults(source: "str | Path | None", frames: int = 20_000, seed: int = 0) -> Faults:
    """Faults by name, placed over `frames`, or from a TOML file whose keys are the fields of `Faults`."""
    if source is None:
        return NO_FAULTS
    if str(source) in PROFILES:
        return PROFILES[str(source)].place(frames, seed)
    path = Path(source)
    try:
        data = untrusted.parse_toml(untrusted.read_file(path, untrusted.TOML_MAX))
    except FileNotFoundError:
        raise AnnulusError(f"{source}: no such fault file, and not one of {', '.join(PROFILES)}") from None
    except (OSError, ValueError) as error:
        raise AnnulusError(f"{path}: cannot be read as TOML: {error}") from None
    try:
        return Faults.from_dict(data)
    except AnnulusError as error:
        raise AnnulusError(f"{path}: {error}") from None
