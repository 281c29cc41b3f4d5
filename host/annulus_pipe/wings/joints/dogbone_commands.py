"""`annulus joint`, of dogbones: their strengths, light through them, and whether joints tell good from bad."""

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus_pipe.cli.show import Json, progress
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.commands import WALL_AGREES, agree, app

ANGLE_AGREES_DEG = 0.5


class Sense(StrEnum):
    SAME = "same"
    MIRRORED = "mirrored"
    EITHER = "either"


SENSES = {Sense.SAME: (1,), Sense.MIRRORED: (-1,), Sense.EITHER: (1, -1)}


@app.command("correlate", epilog="Example: annulus joint correlate joint-7/result strength.csv")
def correlate_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `annulus joint image` wrote.")],
    strength: Annotated[Path, typer.Argument(help="CSV of dogbones: angle_deg,energy_j and what else there is.")],
    feature: Annotated[
        list[str] | None, typer.Option(help="Feature in features.json, again for more: each more costs power.")
    ] = None,
    within_deg: Annotated[
        float,
        typer.Option(min=0, max=180, help="The strengths' zero angle is unknown by so much either way; 0: known."),
    ] = 40.0,
    sense: Annotated[
        Sense, typer.Option(help="Do the dogbones' angles run as the volume's, against them, or is it not known?")
    ] = Sense.EITHER,
    mean_deg: Annotated[
        float,
        typer.Option(min=0, max=90, help="A dogbone's width round the pipe: the feature's mean over it is taken."),
    ] = 20.0,
    as_json: Json = False,
) -> None:
    """Do a joint's features go with its dogbones' strengths? By default W and T.

    The p-value is that of the whole search: the best |r| over all shifts and senses, against features as smooth that
    have nothing to do with the strengths. Writes correlate.json and correlate.png into DIR.
    """
    from annulus_pipe.wings.joints.measure.statistics import LEVEL, Search, Strengths, correlate, power
    from annulus_pipe.wings.joints.pictures import write_correlation
    from annulus_pipe.wings.joints.strength_file import read_strengths

    names = list(dict.fromkeys(feature or ("W", "T")))
    curves = _means(folder / "features.json", names, mean_deg)
    angles, energies = read_strengths(strength)
    try:
        strengths = Strengths(angles, energies)
    except AnnulusError as error:
        raise AnnulusError(f"{strength}: {error}") from None
    search = Search(within_deg, senses=SENSES[sense])
    relations = correlate(curves, strengths, search)
    content: dict[str, Any] = {
        "strengths": str(strength),
        "n": len(angles),
        "angle_deg": angles,
        "energy_j": energies,
        "within_deg": within_deg,
        "sense_sought": sense.value,
        "mean_deg": mean_deg,
        "level": LEVEL,
        "features": {
            one.name: {
                "r": one.r,
                "shift_deg": one.shift_deg,
                "sense": one.sense,
                "p": one.p,
                "p_all": one.p_all,
                "least_p": one.least_p,
                "p_rotated": one.p_rotated,
                "least_p_rotated": one.least_p_rotated,
                "ordinary_p": one.ordinary_p,
                "related": one.related,
                "distance_correlation": one.distance,
                "distance_p": one.distance_p,
                "told_if_r_0.8": power(curves[one.name], angles, search),
                "told_if_r_0.8_known_zero": power(curves[one.name], angles, Search(0.0, senses=(1,))),
            }
            for one in relations
        },
    }
    for one in content["features"].values():
        one["verdict"] = _verdict(one, LEVEL)
    files = write_correlation(folder, content, curves, {one.name: one.chance for one in relations})
    if as_json:
        print((folder / "correlate.json").read_text())
        return
    print(f"strengths  {len(angles)} dogbones; sought within {within_deg:g} deg either way, sense {sense.value}")
    for name, one in content["features"].items():
        print(
            f"{name:<10} r {one['r']:+.3f} at shift {one['shift_deg']:+g} deg, "
            f"{'same sense' if one['sense'] > 0 else 'mirrored'}; p over the search {one['p']:.4f}, over all tried "
            f"{one['p_all']:.4f}, least p {one['least_p']:.4f}, n {len(angles)}: {one['verdict']}"
        )
        print(
            f"           its own rotations do as well in {one['p_rotated']:.3f}, least {one['least_p_rotated']:.3f} "
            "(both times the features tried)"
        )
        print(
            f"           distance correlation at its best {one['distance_correlation']:+.3f}, p over the search "
            f"{one['distance_p']:.4f}; for a look, in no verdict"
        )
        for sought, key in (("", ""), (", zero and sense known", "_known_zero")):
            seen, believed = one[f"told_if_r_0.8{key}"]
            print(
                f"           a true r of 0.8{sought}: p <= {LEVEL:g} in {100 * seen:.0f} %, "
                f"called related in {100 * believed:.0f} %"
            )
    print(f"files      {', '.join(str(file) for file in files)}")


@app.command("transmission", epilog="Example: annulus joint transmission joint-7/result joint-7/ots.csv")
def transmission_command(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the results: that of `annulus joint image`.")
    ],
    lines: Annotated[Path, typer.Argument(help="CSV of line scans: z_mm, then mV of each dogbone_<degrees>.")],
    strength: Annotated[Path | None, typer.Option(help="CSV of the same dogbones: angle_deg,energy_j.")] = None,
    zero_deg: Annotated[
        float | None,
        typer.Option(help="The CT's angle of dogbone_0, if known: its thickness is then taken out (Beer-Lambert)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Light through a joint's dogbones: lines aligned, their own plain wall and thickness taken out, compared.

    Writes transmission.json and transmission.png into DIR: by dogbone the joint's absorbance over plain wall with its
    sigma, and the source's smoothed gradient and moving deviation beside what plain wall shows of them.
    """
    import numpy as np

    from annulus_pipe.wings.joints.measure.transmission import against_strengths, transmission
    from annulus_pipe.wings.joints.pictures import write_transmission
    from annulus_pipe.wings.joints.raster_file import read_walls
    from annulus_pipe.wings.joints.strength_file import read_strengths, read_transmission

    z, angles, mv = read_transmission(lines)
    try:
        found = transmission(z, mv)
        if zero_deg is not None:
            found = transmission(z, mv, _thickness(*read_walls(folder), (angles + zero_deg) % 360, z, found.joint_mm))
    except AnnulusError as error:
        raise AnnulusError(str(error) if str(folder) in str(error) else f"{lines}: {error}") from None
    inside = found.inside
    content: dict[str, Any] = {
        "lines": str(lines),
        "units": "mm, degrees, absorbance to base e",
        "dogbone_deg": angles.tolist(),
        "shift_mm": found.shift_mm,
        "shift_sigma_mm": found.shift_sigma_mm,
        "joint_mm": list(found.joint_mm),
        "depth": found.depth,
        "depth_sigma": found.depth_sigma,
        "gradient_per_mm": np.abs(found.gradient[:, inside]).max(axis=1),
        "plain_gradient_per_mm": found.plain_gradient,
        "deviation": found.deviation[:, inside].max(axis=1),
        "plain_deviation": found.plain_deviation,
        "alpha_per_mm": found.alpha,
        "alpha_sigma_per_mm": found.alpha_sigma,
        "thickness_taken_out": bool(zero_deg is not None and found.thickness_out),
    }
    if strength is not None:
        at, energy = read_strengths(strength)
        same = np.abs((at[None, :] - angles[:, None] + 180) % 360 - 180) < ANGLE_AGREES_DEG
        if not same.any(axis=1).all():
            raise AnnulusError(f"{strength}: has not the {len(angles)} dogbones of {lines}, expected their angles")
        energy = energy[np.argmax(same, axis=1)]
        r, as_good, least = against_strengths(found.depth, energy)
        content |= {"energy_j": energy.tolist(), "r": r, "as_good_by_turning": as_good, "least_by_turning": least}
    curves = {"z_mm": z, "absorbance": found.absorbance, "gradient": found.gradient, "deviation": found.deviation}
    files = write_transmission(folder, content, curves)
    if as_json:
        print((folder / "transmission.json").read_text())
        return
    print(f"lines      {len(angles)} dogbones, aligned to {found.shift_sigma_mm[0]:.2f} mm (sigma)")
    print(f"joint      {found.joint_mm[0]:.2f} to {found.joint_mm[1]:.2f} mm")
    for k, angle in enumerate(angles):
        print(
            f"{angle:>6g} deg  absorbance {found.depth[k]:.4f}, sigma {found.depth_sigma[k]:.4f}; gradient "
            f"{content['gradient_per_mm'][k]:.3f} /mm, deviation {content['deviation'][k]:.4f}"
        )
    print(f"plain wall gradient {found.plain_gradient:.3f} /mm, deviation {found.plain_deviation:.4f} (1 in 400 above)")
    if zero_deg is None:
        print("thickness  each line's own plain wall is taken out; the CT's needs --zero-deg")
    else:
        done = "taken out along the lines" if content["thickness_taken_out"] else "left in: alpha is not told from 0"
        print(f"thickness  alpha {found.alpha:.3f} /mm, sigma {found.alpha_sigma:.3f}: {done}")
    if strength is not None:
        print(
            f"strengths  r {content['r']:+.3f} over {len(angles)} dogbones; turned or mirrored "
            f"{100 * content['as_good_by_turning']:.0f} % of ways do as well, "
            f"least {100 * content['least_by_turning']:.0f} %"
        )
    print(f"files      {', '.join(str(file) for file in files)}")


@app.command("strip", epilog="Example: annulus joint strip dogbones/57AB-45.tif -o dogbones/57AB-45")
def strip_command(
    ct: Annotated[
        Path, typer.Argument(help="CT of one dogbone: TIFF stack, .npy, or folder of slices; ct.json beside it.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    voxel_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="Z Y X", help="Size of a voxel, mm, in place of ct.json's."),
    ] = None,
    as_json: Json = False,
) -> None:
    """W and T of one dogbone that was scanned alone: a strip along the volume's slices, its beads on.

    Writes strip.json and strip.png. As with a pipe, plain wall has to be seen on both sides of the joint.
    """
    from annulus_pipe.wings.joints.measure import strip
    from annulus_pipe.wings.joints.pictures import write_strip
    from annulus_pipe.wings.joints.volume_file import open_volume

    volume = open_volume(ct, voxel_mm)
    with progress() as report:
        try:
            found = strip(volume, progress=report)
        except AnnulusError as error:
            raise AnnulusError(str(error) if str(ct) in str(error) else f"{ct}: {error}") from None
    agree(ct, volume, volume.wall_mm, found.wall_mm, "the wall", WALL_AGREES)
    content: dict[str, Any] = {
        "ct": str(ct),
        "voxel_mm": list(volume.voxel_mm),
        "W_mm": found.w_mm,
        "W_sigma_mm": found.w_sigma_mm,
        "T_mm": found.t_mm,
        "T_sigma_mm": found.t_sigma_mm,
        "wall_mm": found.wall_mm,
        "width_mm": found.width_mm,
        "haz": found.haz,
        "haz_sigma": found.haz_sigma,
        "lean_deg": found.lean_deg,
        "joint_mm": found.joint_mm,
    }
    files = write_strip(out, content, found.z_mm, found.across_mm, found.section)
    if as_json:
        print((out / "strip.json").read_text())
        return
    print(f"strip      {found.width_mm:.1f} mm wide, wall {found.wall_mm:.2f} mm, leans by {found.lean_deg:.1f} deg")
    for name, value, sigma, why in (
        ("W", found.w_mm, found.w_sigma_mm, "no zone stands out of plain wall"),
        ("T", found.t_mm, found.t_sigma_mm, "no notch is seen on both faces"),
    ):
        words = f"{value:.2f} mm, sigma {sigma:.2f} mm" if math.isfinite(value) else f"not told: {why}"
        print(f"{name:<10} {words}")
    print(f"files      {', '.join(str(file) for file in files)}")


def _thickness(z_ct: Any, phi: Any, wall: Any, fusion: Any, angles: Any, z: Any, joint: tuple[float, float]) -> Any:
    """(n, Z) mm of wall along lines whose joint is there, by the CT's (Z, P) wall and (P,) fusion plane."""
    import numpy as np

    out = []
    for angle in angles:
        column = int(np.argmin(np.abs((phi - angle + 180) % 360 - 180)))
        out.append(np.interp(z - sum(joint) / 2, z_ct - fusion[column], wall[:, column], left=np.nan, right=np.nan))
    return np.stack(out)


def _means(source: Path, names: list[str], mean_deg: float) -> dict[str, Any]:
    """(P,) each: named features of a features.json, mean over a dogbone, even round the pipe."""
    from annulus_pipe.wings.joints.measure.statistics import moving_mean
    from annulus_pipe.wings.joints.strength_file import read_features

    phi, raw = read_features(source, names)
    out = {}
    for name, values in raw.items():
        try:
            out[name] = moving_mean(phi, values, mean_deg)
        except AnnulusError as error:
            raise AnnulusError(f"{source}: {name} is {error}") from None
    return out


def _verdict(one: dict[str, Any], level: float) -> str:
    if one["related"]:
        return "related"
    if max(one["least_p"], one["least_p_rotated"]) > level:
        return "cannot be told, whatever had come out: too wide a search for so smooth a feature; mark the zero angle"
    return "not told from chance"


@app.command("classify", epilog="Example: annulus joint classify dogbones.csv -o clusters")
def classify_command(
    dogbones: Annotated[
        Path,
        typer.Argument(
            help="CSV: joint (a folder of `joint image` beside it), angle_deg of the CT, result good or bad."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    feature: Annotated[
        list[str] | None, typer.Option(help="Feature in features.json, again for more. Default: W and T.")
    ] = None,
    mean_deg: Annotated[
        float,
        typer.Option(min=0, max=90, help="A dogbone's width round the pipe: the feature's mean over it is taken."),
    ] = 20.0,
    as_json: Json = False,
) -> None:
    """Do W and T tell good dogbones from bad in a joint they were not fitted on?

    Every joint is told by what the others say, never by itself. p: how often results turned round their joints and
    dealt among them are told as well; each other set of features tried makes it weaker, and nobody but you counts them.
    Writes clusters.json and clusters.png.
    """
    import numpy as np

    from annulus_pipe.wings.joints.measure.clusters import leave_one_out
    from annulus_pipe.wings.joints.measure.statistics import LEVEL
    from annulus_pipe.wings.joints.pictures import write_clusters
    from annulus_pipe.wings.joints.strength_file import read_results

    names = list(dict.fromkeys(feature or ("W", "T")))
    joints, angles, good = read_results(dogbones)
    folders = list(dict.fromkeys(joints))
    values = np.empty((len(joints), len(names)))
    for folder in folders:
        mine = [k for k, one in enumerate(joints) if one == folder]
        for column, mean in enumerate(_means(dogbones.parent / folder / "features.json", names, mean_deg).values()):
            turn = np.linspace(0, 360, len(mean), endpoint=False)
            values[mine, column] = np.interp(angles[mine], turn, mean, period=360)
    pipe = np.array([folders.index(one) for one in joints])
    try:
        found = leave_one_out(values, good, pipe, angles)
    except AnnulusError as error:
        raise AnnulusError(f"{dogbones}: {error}") from None
    verdict = (
        "told"
        if found.p <= LEVEL
        else (
            "cannot be told, whatever had come out: too few joints" if found.least_p > LEVEL else "not told from chance"
        )
    )
    content: dict[str, Any] = {
        "dogbones": str(dogbones),
        "features": names,
        "mean_deg": mean_deg,
        "joints": folders,
        "joint": joints,
        "angle_deg": angles,
        "good": good.tolist(),
        "values": values,
        "called_good": found.called_good,
        "accuracy": found.accuracy,
        "balanced": found.balanced,
        "p": found.p,
        "least_p": found.least_p,
        "verdict": verdict,
    }
    files = write_clusters(out, content)
    if as_json:
        print((out / "clusters.json").read_text())
        return
    for number, folder in enumerate(folders):
        mine = pipe == number
        right = [called == is_good for called, is_good in zip(found.called_good, good, strict=True)]
        print(f"{folder:<24} {int(np.array(right)[mine].sum())} of {int(mine.sum())} told rightly by the others")
    print(
        f"accuracy   {100 * found.accuracy:.0f} % of {len(good)} dogbones in {len(folders)} joints; good and bad alike "
        f"{100 * found.balanced:.0f} % (guessing 50)"
    )
    print(f"p          {found.p:.4f}, least {found.least_p:.4f}: {verdict}")
    print(f"files      {', '.join(str(file) for file in files)}")
