"""What each witness keeps in mind: how late the driver usually is, which frames it counted, which pictures were shown.

None of them learns from a frame that another contradicts.
"""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.capture.proof import Witness
from annulus_pipe.vocabulary import CameraSequence

LAGS_KEPT = 64
LATE_KEPT = 32
PAIRS_MIN, PAIRS_KEPT = 16, 256  # frames in which stamps and arrivals are compared
FOLLOWS = 0.75  # of a late arrival: stamps that move by less are not made when frames are handed over ..
SIGMAS = 2.0  # .. as sure as that
LAGS_MIN = 8  # before the usual lag is spoken of
LAG_RANK = 20  # one in so many may be quicker than the usual, by chance
QUICKER = 0.25  # of a period: what comes so much sooner than usual cannot be that frame
SLOWER = 0.5  # of a period: what comes so much later had to wait
PICTURES_KEPT = 16  # more than a driver has buffers
UNLIT_MIN = 4  # pictures of the LED before what is dark in them is usual
COUNT_FRAMES = 4  # that agree before a count is relied on


class Arrivals:
    """How long after its edge a frame is in hand: a host that stalls makes that longer, nothing makes it shorter."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._lags: deque[int] = deque(maxlen=LAGS_KEPT)
        self._waited: deque[int] = deque(maxlen=LATE_KEPT)  # one after the other
        self._learnt = 0
        self.usual_ns: int | None = None

    def believe(self, lags_ns: Iterable[int]) -> None:
        """Forget what was; these are frames of the same seconds."""
        self._lags.clear()
        self._waited.clear()
        self.usual_ns = None
        for lag in lags_ns:
            self._lags.append(lag)
        self._judge()

    def early(self, lag_ns: int) -> bool:
        """Whether nobody could have had it so soon."""
        return lag_ns < -QUICKER * self._period_ns or (
            self.usual_ns is not None and lag_ns < self.usual_ns - QUICKER * self._period_ns
        )

    def waited(self, lag_ns: int) -> bool:
        return self.usual_ns is not None and lag_ns > self.usual_ns + SLOWER * self._period_ns

    def usual(self, lag_ns: int) -> bool:
        return self.usual_ns is not None and not self.early(lag_ns) and not self.waited(lag_ns)

    @property
    def for_good(self) -> bool:
        """Whether frames have been coming late for long, by the same time each: that is no backlog."""
        return len(self._waited) == LATE_KEPT and max(self._waited) - min(self._waited) <= SLOWER * self._period_ns

    def learn(self, lag_ns: int, counted: bool) -> None:
        """Of a frame that nobody contradicts. A backlog says nothing of the driver, unless it never ends and the
        driver's count knows that no frames are missing.
        """
        if self.waited(lag_ns):
            self._waited.append(lag_ns)
            if counted and self.for_good:
                self.believe(list(self._waited))
            return
        self._waited.clear()
        self._lags.append(lag_ns)
        self._learnt += 1
        if self.usual_ns is None or lag_ns < self.usual_ns or self._learnt % LAGS_MIN == 0:
            self._judge()

    def _judge(self) -> None:
        if len(self._lags) >= LAGS_MIN:
            self.usual_ns = sorted(self._lags)[len(self._lags) // LAG_RANK]


class Delivery:
    """Whether a camera's stamps are made when its frames are handed over. Stamp and arrival are one witness then: a
    driver that keeps frames moves both.
    """

    def __init__(self) -> None:
        self._pairs: deque[tuple[int, int]] = deque(maxlen=PAIRS_KEPT)

    def believe(self, off_ns: Iterable[int], lags_ns: Iterable[int]) -> None:
        """Forget what was; these are frames of the same seconds."""
        self._pairs.clear()
        self._pairs.extend(zip(off_ns, lags_ns, strict=True))

    def learn(self, off_ns: int, lag_ns: int) -> None:
        """Of a frame that nobody contradicts: its stamp's distance from where it should be, and its lag."""
        self._pairs.append((off_ns, lag_ns))

    @property
    def pairs(self) -> int:
        return len(self._pairs)

    @property
    def one_witness(self) -> bool:
        """Whether stamp and arrival are one, or may be."""
        return self.stamps is not False

    @property
    def stamps(self) -> bool | None:
        """None where nobody can tell: few frames, or stamps that vary so much by themselves, or arrivals so little."""
        if len(self._pairs) < PAIRS_MIN:
            return None
        off, lag = np.array(self._pairs, dtype=np.float64).T
        off, lag = off - off.mean(), lag - lag.mean()
        if (varies := float(lag @ lag)) == 0.0:
            return None
        slope = (
            float(off @ lag) / varies
        )  # 1: a frame that comes later is stamped later; 0: its stamp knows nothing of it
        rest = off - slope * lag
        error = SIGMAS * math.sqrt(float(rest @ rest) / (len(off) - 2) / varies)
        if slope + error < FOLLOWS:
            return False
        return True if slope - error > 1.0 - FOLLOWS else None


class Count:
    """The driver's count minus the ordinal of the edge, which nothing changes but a driver that counts anew."""

    def __init__(self) -> None:
        self.ahead: int | None = None
        self._candidate: int | None = None
        self._agreed = 0

    def believe(self, ahead: int | None) -> None:
        self.ahead, self._candidate, self._agreed = ahead, None, 0

    def learn(self, sequence: CameraSequence, ordinal: int) -> None:
        """Of a frame that was believed, while no count was."""
        if self.ahead is not None:
            return
        if self._candidate != sequence - ordinal:
            self._candidate, self._agreed = sequence - ordinal, 0
        self._agreed += 1
        if self._agreed >= COUNT_FRAMES:
            self.ahead = self._candidate


class RecentPictures:
    """Those lately shown. Dark ones too: one may stand below in a torn picture, but two may be alike by chance."""

    def __init__(self) -> None:
        self._wholes: deque[int] = deque(maxlen=PICTURES_KEPT)
        self._tops: deque[int | None] = deque(maxlen=PICTURES_KEPT)  # theirs, each at the same place
        self._bottoms: deque[int | None] = deque(maxlen=PICTURES_KEPT)
        self.again = (
            False  # the last one was shown before, down to the noise: where it is dark that may be all there is
        )
        self._unlit: deque[tuple[bool, ...]] = deque(maxlen=PICTURES_KEPT)  # bands of LED pictures

    def met(self, picture: Photometry) -> Witness | None:
        """Whether all of it was shown before, or it is of two exposures. Ask once for each frame."""
        self.again = picture.fingerprint is not None and picture.fingerprint in self._wholes
        found = Witness.TORN if picture.torn or self._newly_unlit(picture.unlit) else None
        if picture.fingerprint is None:
            return found
        if self.again:
            return found if picture.light is Light.DARK else Witness.REPEATED
        top, bottom = picture.top, picture.bottom
        if (top is not None and top in self._tops) or (bottom is not None and bottom in self._bottoms):
            found = Witness.TORN
        self._wholes.append(picture.fingerprint)
        self._tops.append(top)
        self._bottoms.append(bottom)
        return found

    def _newly_unlit(self, bands: tuple[bool, ...]) -> bool:
        """Whether a band has dark rows that it has not in other pictures of the LED: a mask is always there."""
        if not bands:
            return False
        before = list(self._unlit)
        self._unlit.append(bands)
        usual = len(before) >= UNLIT_MIN
        return any(
            now and not (usual and 2 * sum(then[i] for then in before) >= len(before)) for i, now in enumerate(bands)
        )
