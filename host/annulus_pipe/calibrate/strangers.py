"""Photographs that do not belong with the others: another camera's, or turned or mirrored before they came here.

A lens fitted to all of them leaves little over: two cameras of one kind differ by some pixels of the principal point,
which every photograph's own pose nearly makes good. What gives them away is that the photographs disagree in two lots.
Past its own pose, a photograph says of the lens where it lies (its pull) and how firmly (its information). They are
parted into the two lots that two lenses fit best, as k-means does; on the line between the two lenses each photograph
then has its place. Any album can be parted somehow, so two things must be more than in albums of one camera: what two
lenses gain, where photographs are as far off as these, each in a random direction; and how far apart the lots lie for
their width, where photographs are strewn normally along that line. Where a camera's principal point is the image's
middle, a turned photograph is no other, and does no harm.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.intrinsics import Intrinsics, TargetObservation, fit_intrinsics, target_pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError

# By test_strangers: real and drawn albums of two cameras, or with turned ones, are parted rightly, of one camera never.
ALBUMS = 200  # drawn of one camera, of either kind: none of them may be parted as well
STARTS = 6  # random partings to begin from, besides those along the photographs' main disagreements
HELD = 1e-3  # of all photographs' information: keeps the lens of a small lot from what it says nothing of
FAR = 10.0  # variances of photographs along the line to the turned lens are gained by turning a turned one back, ..
MOST = 0.6  # .. and this part of what the best lens for that photograph alone gains
MEDIAN_SQUARE = 0.455  # of a standard normal variable
MINORITY = 0.5  # of the rest: more of them are no strangers, nobody can say whose photographs are meant
GAINED = 0.2  # of the squared residuals: below, two lenses are hardly better for whoever uses them
LEFT = 0.25  # of the squared residual above the usual: may be left in a photograph turned back
WORSE = 3.0  # times what a photograph usually gains by a lens of its own: it does not belong to the others'
LOT = 3  # photographs that a camera of their own fits; two are fitted by many
ALIKE = 2.0  # times the others' residual: they fit
OTHER = "another camera's, or zoomed"
TURNS: dict[str, tuple[float, float]] = {
    "turned by 180 degrees": (-1.0, -1.0),
    "mirrored left to right": (-1.0, 1.0),
    "mirrored top to bottom": (1.0, -1.0),
}


def strangers(fit: Intrinsics, views: Sequence[TargetObservation], names: Sequence[str]) -> dict[int, str]:
    """Which views of a fit do not belong with the rest, and why. Raises AnnulusError, one line with their `names`,
    where neither lot is clearly the larger."""
    lot = two_lots(fit)
    few = lone_turned(fit) if lot is None else np.flatnonzero(lot)
    rest = [view for i, view in enumerate(views) if i not in few]
    if not len(few) or len(rest) < 2:
        return {}
    camera = fit.camera
    alone = fit_intrinsics(rest, camera.width, camera.height, camera.model, camera)
    if lot is not None:
        few = _clear_of(fit, alone, views, few)
        rest = [view for i, view in enumerate(views) if i not in few]
    if lot is None or len(few) < 2:
        each = {int(i): how_turned(alone.camera, [views[i]], alone.rms_px) for i in few}
        return {i: f"{turned}, unlike the {len(rest)} others" for i, turned in each.items() if turned}
    turned = how_turned(alone.camera, [views[i] for i in few], alone.rms_px)
    why = f"{turned or OTHER}, unlike the {len(rest)} others"
    refuse_many([names[i] for i in few], len(rest), why)
    return {int(i): why for i in few}


def misfits(fit: Intrinsics, views: Sequence[TargetObservation], names: Sequence[str]) -> dict[int, str]:
    """Why views do not fit a camera, where that can be said: they are turned, or of another camera together."""
    camera = fit.camera
    each = {i: how_turned(camera, [view], fit.rms_px) for i, view in enumerate(views)}
    out = {i: f"{turned}, unlike the {len(fit.seen)} others" for i, turned in each.items() if turned}
    left = [i for i in each if i not in out]
    if len(left) >= LOT:
        try:
            own = fit_intrinsics([views[i] for i in left], camera.width, camera.height, camera.model, robust=True)
        except AnnulusError:
            return out
        fits = [i for i, rms in zip(left, own.view_rms_px, strict=True) if rms < ALIKE * fit.rms_px]
        if len(fits) >= LOT:
            why = f"{OTHER}, unlike the {len(fit.seen)} others"
            refuse_many([names[i] for i in fits], len(fit.seen), why)
            out |= dict.fromkeys(fits, why)
    return out


def refuse_many(names: Sequence[str], rest: int, why: str) -> None:
    """Raises AnnulusError where so many photographs are not like the rest that none can say which lot is meant."""
    if len(names) > MINORITY * rest:
        raise AnnulusError(f"{len(names)} photographs are {why} ({', '.join(names)}). Calibrate each lot by itself.")


def two_lots(fit: Intrinsics) -> NDArray[np.bool_] | None:
    """(V,) the smaller lot of views, where two lenses fit them clearly better than one; None where they agree. A lot
    has at least two: one photograph alone may be off for many reasons."""
    if len(fit.pulls) < 4:
        return None
    size = 1 / np.sqrt(np.diag(fit.information.sum(axis=0)))
    value, way = np.linalg.eigh(np.outer(size, size) * fit.information.sum(axis=0))
    unit = size[:, None] * way / np.sqrt(np.maximum(value, 1e-12 * value[-1]))  # all views' information becomes 1
    says, pull = unit.T @ fit.information @ unit, fit.pulls @ unit
    rng = np.random.default_rng(0)
    gain, lot = _parted(says, pull, rng)
    if lot is None or gain < GAINED * sum(float((off**2).sum()) for off in fit.residuals):
        return None
    clear, firm = _clear(says, pull, lot)
    for _ in range(ALBUMS):
        if _clearest_normal(firm, rng) >= clear:
            return None
    root, any_lens = _whitened(says, pull)
    for _ in range(ALBUMS):
        drawn = rng.normal(size=pull.shape)
        drawn *= (np.sqrt(any_lens) / np.linalg.norm(drawn, axis=1))[:, None]
        pulls = np.einsum("vpq,vq->vp", root, drawn)
        pulls -= says @ pulls.sum(axis=0)  # as one lens fitted to all leaves them
        if _parted(says, pulls, rng)[0] >= gain:
            return None
    return lot


def _clear_of(
    fit: Intrinsics, alone: Intrinsics, views: Sequence[TargetObservation], few: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Those of a lot that the others' lens fits much worse than one of their own; by chance some that fit are in it."""
    _, gained = _whitened(fit.information, fit.pulls)
    usual = float(np.median(_whitened(alone.information, alone.pulls)[1]))
    worse = [
        len(views[i].pixels) * (_rms(alone.camera, [views[i]]) ** 2 - fit.view_rms_px[i] ** 2) + gained[i] for i in few
    ]
    return few[np.array(worse) > WORSE * usual]


def lone_turned(fit: Intrinsics) -> NDArray[np.int64]:
    """Single views that lie turned among those of one camera.

    The lens as a turned photograph shows it is known: the principal point on the other side of the image's middle,
    tangential distortion the other way. Views lie at the near end of the line to it, turned ones at the far end.
    """
    camera = fit.camera
    beside = np.array([camera.width - 1, camera.height - 1]) - 2 * np.array([camera.cx, camera.cy])
    far = np.zeros(len(fit.pulls), bool)
    _, any_lens = _whitened(fit.information, fit.pulls)
    usual = float(np.median(any_lens)) / fit.pulls.shape[1]
    for turn in TURNS.values():
        there, other = np.zeros(fit.pulls.shape[1]), np.array(turn) < 0
        there[[2, 3]] = np.where(other, beside, 0.0)
        if camera.model == "pinhole":
            there[[7, 6]] = np.where(other, -2 * np.array([camera.distortion[3], camera.distortion[2]]), 0.0)
        firm = np.maximum(np.einsum("p,vpq,q->v", there, fit.information, there), 1e-300)
        place = fit.pulls @ there / firm
        width = float(np.median(firm * place**2)) / MEDIAN_SQUARE
        gain = firm * (2 * place - 1)  # of its squared residuals, by turning it back
        far |= (gain > FAR * max(width, usual)) & (gain > MOST * any_lens)
    return np.flatnonzero(far)


def how_turned(camera: Camera, views: Sequence[TargetObservation], usual_px: float) -> str:
    """Which of `TURNS` makes views fit the camera, and "" where none does or they fit as they are.

    usual_px : rms of views that fit. Turned views leave little more than that, of what they leave as they are.
    """
    as_is = _rms(camera, views)
    turned = {name: _rms(camera, [_turned(view, camera, turn) for view in views]) for name, turn in TURNS.items()}
    best = min(turned, key=lambda name: turned[name])
    return best if turned[best] ** 2 - usual_px**2 < LEFT * (as_is**2 - usual_px**2) else ""


def _turned(view: TargetObservation, camera: Camera, turn: tuple[float, float]) -> TargetObservation:
    """As the photograph shows it turned back; a mirrored target stays a target, its columns counted the other way."""
    pixels = view.pixels * turn + np.where(np.array(turn) < 0, [camera.width - 1.0, camera.height - 1.0], 0.0)
    return TargetObservation(view.target_mm * [turn[0] * turn[1], 1.0], pixels)


def _rms(camera: Camera, views: Sequence[TargetObservation]) -> float:
    try:
        each = [(target_pose(camera, view)[2], len(view.pixels)) for view in views]
    except ValueError:
        return np.inf
    return float(np.sqrt(sum(rms**2 * n for rms, n in each) / sum(n for _, n in each)))


def _whitened(says: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(V, P, P) roots of the views' information; (V,) what each view's squared residuals gain by a lens of its own."""
    unit = 1 / np.sqrt(np.diag(says.sum(axis=0)))
    values, ways = np.linalg.eigh(np.outer(unit, unit) * says)
    firm = values > 1e-9 * values.max()
    along = np.einsum("vpq,vp->vq", ways, unit * pull)
    root = ways * np.sqrt(np.maximum(values, 0.0))[:, None] / unit[:, None]
    return root, (np.where(firm, along**2, 0.0) / np.where(firm, values, 1.0)).sum(axis=1)


def _parted(says: FloatArray, pull: FloatArray, rng: np.random.Generator) -> tuple[float, NDArray[np.bool_] | None]:
    """The parting in two lots that lowers the squared residuals most, and by how much; at least two views a lot."""
    views = len(pull)
    along = np.linalg.svd(pull, full_matrices=False)[0].T[:4]
    begin = [*(along > np.median(along, axis=1, keepdims=True)), *(rng.random((STARTS, views)) < 0.5)]
    best: tuple[float, NDArray[np.bool_] | None] = (0.0, None)
    for first in begin:
        lot = np.asarray(first, bool)
        for _ in range(20):
            lenses = _lenses(says, pull, lot)
            off = [np.einsum("p,vpq,q->v", lens, says, lens) - 2 * pull @ lens for lens in lenses]
            again = off[0] < off[1]
            if (again == lot).all():
                break
            lot = again
        if min(np.count_nonzero(lot), np.count_nonzero(~lot)) < 2:
            continue
        gain = sum(
            float(pull[one].sum(axis=0) @ lens) for one, lens in zip((lot, ~lot), _lenses(says, pull, lot), strict=True)
        )
        if gain > best[0]:
            best = gain, (lot if 2 * np.count_nonzero(lot) <= views else ~lot)
    return best


def _lenses(says: FloatArray, pull: FloatArray, lot: NDArray[np.bool_]) -> list[FloatArray]:
    held = HELD * np.eye(pull.shape[1])
    return [np.linalg.solve(says[one].sum(axis=0) + held, pull[one].sum(axis=0)) for one in (lot, ~lot)]


def _clear(says: FloatArray, pull: FloatArray, lot: NDArray[np.bool_]) -> tuple[float, FloatArray]:
    """How far apart two lots lie for their width: F along the line between their lenses; and (V,) how firmly each view
    is placed there."""
    a, b = _lenses(says, pull, lot)
    apart = a - b
    firm = np.maximum(np.einsum("p,vpq,q->v", apart, says, apart), 1e-300)
    place = (pull - says @ ((a + b) / 2)) @ apart / firm
    return _apart(place, firm, lot), firm


def _clearest_normal(firm: FloatArray, rng: np.random.Generator) -> float:
    """The same of the best parting of places strewn normally along a line."""
    place = rng.normal(size=len(firm)) / np.sqrt(firm)
    order = np.argsort(place)
    place, firm = place[order], firm[order]
    return max(_apart(place, firm, np.arange(len(firm)) < n) for n in range(2, len(firm) - 1))


def _apart(place: FloatArray, firm: FloatArray, lot: NDArray[np.bool_]) -> float:
    lots = [(place[one], firm[one]) for one in (lot, ~lot)]
    middle = [float((p * f).sum() / f.sum()) for p, f in lots]
    width = sum(float((f * (p - m) ** 2).sum()) for (p, f), m in zip(lots, middle, strict=True)) / (len(place) - 2)
    heavy = [float(f.sum()) for _, f in lots]
    return (middle[0] - middle[1]) ** 2 * heavy[0] * heavy[1] / sum(heavy) / max(width, 1e-300)
