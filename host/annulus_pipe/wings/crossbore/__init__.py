"""Cross bores: where a pipe was drilled through a sewer, by a head with capacitive sectors."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annulus_pipe.daemon.config import HeadConfig
    from annulus_pipe.daemon.observer import Observers
    from annulus_pipe.hooks import Noun, Sheet
    from annulus_pipe.scans.scan import Scan
    from annulus_pipe.wall.profile import Profile
    from annulus_pipe.wall.survey import Survey


def watches(config: "HeadConfig", observers: "Observers") -> None:
    """Bores while the head moves."""
    from annulus_pipe.wings.crossbore.live import Bores

    Bores(config.sectors, observers)


def adds(survey: "Survey", scan: "Scan", profiles: "Sequence[Profile]") -> "Survey":
    """Bores among the features of a recorded scan."""
    from annulus_pipe.wings.crossbore.recorded import with_bores

    return with_bores(survey, scan, profiles)


def sheet(survey: "Survey") -> "Sheet | None":
    """What each sector read, along the pipe."""
    from annulus_pipe.wings.crossbore.lane import Lane

    lane = survey.beside.get("crossbore")
    if not isinstance(lane, Lane):
        return None
    from annulus_pipe.wings.crossbore.picture import sheet_of

    return sheet_of(lane)


def lights() -> Mapping[str, type]:
    """The ground around a pipe, for a simulated head with sectors."""
    from annulus_pipe.wings.crossbore.ground import Ground

    return {"ground": Ground}


def app() -> "Mapping[str, Noun]":
    from annulus_pipe.hooks import Noun

    about = "Cross bores: where a pipe was drilled through a sewer, by a head with capacitive sectors."
    return {"bore": Noun(f"{__name__}.commands", about)}
