"""`annulus joint`: butt-fusion joints, from a CT volume to what may be said of them."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus.cli.show import Json, group, progress
from annulus.vocabulary import AnnulusError

app = group("Butt-fusion joints: beads, heat-affected zone and flaws from a CT volume.")
DIAMETER_AGREES, WALL_AGREES = 0.03, 0.15  # of what ct.json says the pipe has


# With one verb a group would be the verb: `annulus joint CT`.
@app.callback()
def _noun() -> None: ...


@app.command("image", epilog="Example: annulus joint image joint-7/ct.tif -o joint-7/result")
def image_command(
    ct: Annotated[
        Path, typer.Argument(help="TIFF stack, .npy, or folder of a DICOM series or TIFF slices; ct.json beside it.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    voxel_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="Z Y X", help="Size of a voxel, mm, in place of ct.json's."),
    ] = None,
    inner_mm: Annotated[
        float, typer.Option(min=0.1, help="Middle part of the wall whose density is taken, mm of --of-mm.")
    ] = 4.0,
    of_mm: Annotated[float, typer.Option(min=0.1, help="The wall that --inner-mm is a part of, mm.")] = 5.6,
    as_json: Json = False,
) -> None:
    """Beads, hi-lo, thickness, heat-affected zone and flaws of a joint, by angle.

    Writes features.json (by angle, with sigma), maps.npz and pictures. Density is relative to the plain wall of the
    same volume, which has to be seen on both sides of the joint. No CT of a PE joint is public: this is
    proven on simulated ones.
    """
    from annulus.joints import Parts, features, image, maps, summary
    from annulus.record.volume import open_volume
    from annulus.report.joint import write_joint

    parts = Parts(inner_mm, of_mm)
    volume = open_volume(ct, voxel_mm)
    with progress() as report:
        try:
            joint = image(volume, parts, report)
        except AnnulusError as error:
            raise AnnulusError(str(error) if str(ct) in str(error) else f"{ct}: {error}") from None
    for said, found, name, part in (
        (volume.outer_diameter_mm, 2 * joint.found.radius_mm, "outer diameter", DIAMETER_AGREES),
        (volume.wall_mm, joint.found.wall_mm, "wall", WALL_AGREES),
    ):
        if said is not None and abs(found - said) > part * said:
            raise AnnulusError(
                f"{ct}: the pipe's {name} is {found:.2f} mm in the volume and {said:g} mm in ct.json; is the voxel "
                f"size of {' x '.join(f'{v:g}' for v in volume.voxel_mm)} mm right?"
            )
    told = summary(joint)
    named = features(joint)
    files = write_joint(out, named, maps(joint), told)
    if as_json:
        voxels = {"form": volume.form, "shape": list(volume.shape), "voxel_mm": list(volume.voxel_mm)}
        print(json.dumps({"volume": voxels, **told, "flaws": named["found"], "files": [str(file) for file in files]}))
        return
    _print(volume, told, named["found"])
    print(f"files      {', '.join(str(file) for file in files)}")


def _print(volume: Any, told: dict[str, Any], found: list[dict[str, Any]]) -> None:
    def span(name: str) -> str:
        median, least, greatest = (told[name][key] for key in ("median", "least", "greatest"))
        return "not told" if median is None else f"{median:.2f} ({least:.2f} to {greatest:.2f})"

    sizes = " x ".join(str(n) for n in volume.shape), " x ".join(f"{v:.4g}" for v in volume.voxel_mm)
    print(f"volume     {volume.form}, {sizes[0]} voxels (z, y, x) of {sizes[1]} mm")
    print(
        f"pipe       outer diameter {told['outer_diameter_mm']:.2f} mm, wall {span('wall_mm')} mm, "
        f"leaning {told['lean_deg']:.2f} deg, joint at z {told['joint_z_mm']:.2f} mm"
    )
    print(f"bead out   height {span('bead_out_height_mm')} mm, width {span('bead_out_width_mm')} mm")
    print(f"bead in    height {span('bead_in_height_mm')} mm, width {span('bead_in_width_mm')} mm")
    aside = told["hilo_mm"]
    print(
        f"hi-lo      axes {aside['axes_aside']:.3f} mm aside, greatest step outside "
        f"{aside['greatest_outside']:.3f} mm at {aside['at_deg']:.0f} deg, sigma {aside['sigma']:.3f} mm"
    )
    print(f"T          {span('T_mm')} mm, sigma {told['T_sigma_mm']:.3f} mm")
    sigma = told["W_sigma_mm"]
    print(f"W          {span('W_mm')} mm" + ("" if sigma is None else f", sigma {sigma:.3f} mm"))
    print(f"zone       density {span('zone_density_percent')} % of plain wall's")
    for flaw in found:
        print(
            f"{flaw['kind']:<10} at {flaw['phi_deg']:.1f} deg, {flaw['rho']:.2f} mm from the axis, "
            f"{flaw['z'] - told['joint_z_mm']:+.2f} mm from the joint, {flaw['snr']:.0f} sigma"
        )
    if not found:
        print("flaws      none seen in the wall; beads and the skin within two voxels are not looked at")
    for key, word in (("angles_without_zone", "zone"), ("angles_without_bead", "bead")):
        if told[key]:
            print(f"note       {told[key]} angles without a {word} that can be told")
