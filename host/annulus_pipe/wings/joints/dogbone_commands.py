"""`annulus joint`, of dogbones: their strengths, light through them, and whether joints tell good from bad."""

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, progress
from annulus_pipe.wings.joints.commands import app


class Sense(StrEnum):
    SAME = "same"
    MIRRORED = "mirrored"
    EITHER = "either"


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
    from annulus_pipe.wings.joints.dogbones import correlate_strengths

    names = list(dict.fromkeys(feature or ("W", "T")))
    content, files = correlate_strengths(folder, strength, names, within_deg, sense.value, mean_deg)
    if as_json:
        print(files[0].read_text())
        return
    print(f"strengths  {content['n']} dogbones; sought within {within_deg:g} deg either way, sense {sense.value}")
    for name, one in content["features"].items():
        print(
            f"{name:<10} r {one['r']:+.3f} at shift {one['shift_deg']:+g} deg, "
            f"{'same sense' if one['sense'] > 0 else 'mirrored'}; p over the search {one['p']:.4f}, over all tried "
            f"{one['p_all']:.4f}, least p {one['least_p']:.4f}, n {content['n']}: {one['verdict']}"
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
                f"           a true r of 0.8{sought}: p <= {content['level']:g} in {100 * seen:.0f} %, "
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
    from annulus_pipe.wings.joints.dogbones import compare_light

    content, files = compare_light(folder, lines, strength, zero_deg)
    if as_json:
        print(files[0].read_text())
        return
    angles = content["dogbone_deg"]
    print(f"lines      {len(angles)} dogbones, aligned to {content['shift_sigma_mm'][0]:.2f} mm (sigma)")
    print(f"joint      {content['joint_mm'][0]:.2f} to {content['joint_mm'][1]:.2f} mm")
    for k, angle in enumerate(angles):
        print(
            f"{angle:>6g} deg  absorbance {content['depth'][k]:.4f}, sigma {content['depth_sigma'][k]:.4f}; gradient "
            f"{content['gradient_per_mm'][k]:.3f} /mm, deviation {content['deviation'][k]:.4f}"
        )
    print(
        f"plain wall gradient {content['plain_gradient_per_mm']:.3f} /mm, deviation {content['plain_deviation']:.4f} "
        "(1 in 400 above)"
    )
    if zero_deg is None:
        print("thickness  each line's own plain wall is taken out; the CT's needs --zero-deg")
    else:
        done = "taken out along the lines" if content["thickness_taken_out"] else "left in: alpha is not told from 0"
        print(f"thickness  alpha {content['alpha_per_mm']:.3f} /mm, sigma {content['alpha_sigma_per_mm']:.3f}: {done}")
    if strength is not None:
        print(
            f"strengths  r {content['r']:+.3f} over {len(angles)} dogbones; turned or mirrored "
            f"{100 * content['as_good_by_turning']:.0f} % of ways do as well, "
            f"least {100 * content['least_by_turning']:.0f} %"
        )
    print(f"files      {', '.join(str(file) for file in files)}")


@app.command("sweep", epilog="Example: annulus joint sweep srr/points.csv -o srr/result")
def sweep_command(
    table: Annotated[
        Path, typer.Argument(help="CSV: point, file (.s1p, .s2p or CSV, beside it) and, along a dogbone, z_mm.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    parameter: Annotated[str, typer.Option(help="Of a Touchstone file: s11, or s21, s12, s22 of two ports.")] = "s11",
    as_json: Json = False,
) -> None:
    """Sweeps of a resonant probe over frequency: each one's resonance with its sigma, and its shift from the first.

    The first line is what the others are held against: air, say. Writes sweeps.json and sweeps.png.
    """
    from annulus_pipe.wings.joints.sweeps import compare_sweeps

    content, files = compare_sweeps(table, out, parameter.lower())
    if as_json:
        print(files[0].read_text())
        return
    for one in content["points"]:
        if one["f0_hz"] is None:
            print(f"{one['point']:<16} no resonance stands out")
            continue
        words = {None: "", True: ": moved", False: ": no shift beyond its uncertainty"}[one["moved"]]
        shift = "" if one["moved"] is None else f"; shift {one['shift_hz']:+.4g} Hz, sigma {one['shift_sigma_hz']:.2g}"
        print(
            f"{one['point']:<16} {one['f0_hz']:.7g} Hz, sigma {one['f0_sigma_hz']:.2g}, Q {one['quality']:.1f}"
            f"{shift}{words}"
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
    from annulus_pipe.wings.joints.ct import image_strip

    with progress() as report:
        content, files = image_strip(ct, out, voxel_mm, report)
    if as_json:
        print(files[0].read_text())
        return
    print(
        f"strip      {content['width_mm']:.1f} mm wide, wall {content['wall_mm']:.2f} mm, leans by "
        f"{content['lean_deg']:.1f} deg"
    )
    for name, why in (("W", "no zone stands out of plain wall"), ("T", "no notch is seen on both faces")):
        value, sigma = content[f"{name}_mm"], content[f"{name}_sigma_mm"]
        words = f"{value:.2f} mm, sigma {sigma:.2f} mm" if math.isfinite(value) else f"not told: {why}"
        print(f"{name:<10} {words}")
    print(f"files      {', '.join(str(file) for file in files)}")


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
    from annulus_pipe.wings.joints.dogbones import classify_dogbones

    names = list(dict.fromkeys(feature or ("W", "T")))
    content, files = classify_dogbones(dogbones, out, names, mean_deg)
    if as_json:
        print(files[0].read_text())
        return
    right = [called == true for called, true in zip(content["called_good"], content["good"], strict=True)]
    for folder in content["joints"]:
        mine = [is_right for joint, is_right in zip(content["joint"], right, strict=True) if joint == folder]
        print(f"{folder:<24} {sum(mine)} of {len(mine)} told rightly by the others")
    print(
        f"accuracy   {100 * content['accuracy']:.0f} % of {len(right)} dogbones in {len(content['joints'])} joints; "
        f"good and bad alike {100 * content['balanced']:.0f} % (guessing 50)"
    )
    print(f"p          {content['p']:.4f}, least {content['least_p']:.4f}: {content['verdict']}")
    print(f"files      {', '.join(str(file) for file in files)}")
