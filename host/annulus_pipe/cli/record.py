"""`annulus record`: what a recording says of itself, what of it is whole, and it made something else."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus_pipe.cli.show import Json, print_fields, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

app = verbs()

LINES_MAX = 100  # of what is missing, as a note has them

Scan = Annotated[Path, typer.Argument(help="A recording, .mcap.")]


@app.command("info", epilog="Example: annulus record info scan.mcap")
def info(scan: Scan, as_json: Json = False) -> None:
    """Who, where, when and with what a recording was made, how its pictures are kept, how well its places are known.

    Of a torn one also how many frames it lacks at most: the one under way where a program was killed, those the disk
    itself had not been told of where the power went.
    """
    from annulus_pipe.scans.identity import identity

    print_fields(identity(scan), as_json)


@app.command("relabel", epilog="Example: annulus record relabel scan.mcap --audit")
def relabel_command(
    scan: Scan,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The new recording. [default: SCAN-relabelled.mcap]")
    ] = None,
    audit: Annotated[bool, typer.Option("--audit", help="Only compare, and write nothing.")] = False,
    as_json: Json = False,
) -> None:
    """Say the labels and places of a recording again, from its evidence. The original stays as it is.

    Ends with status 1 where something is missing, of the evidence or of the rest; an audit also where something
    differs.
    """
    from annulus_pipe.reprocess.relabel import audit as audit_of
    from annulus_pipe.reprocess.relabel import relabel

    new = out or scan.with_name(f"{scan.stem}-relabelled.mcap")
    found = audit_of(scan) if audit else relabel(scan, new)
    if as_json:
        print(json.dumps(found.to_dict()))
    else:
        _print_table(found.to_dict())
        if not audit:
            print(f"recording  {new}")
    _print_missing(scan, found.lacks)
    if found.lacks or found.without_evidence or (audit and found.changed):
        raise typer.Exit(1)


@app.command("verify", epilog="Example: annulus record verify scan.mcap")
def verify(scan: Scan, as_json: Json = False) -> None:
    """Read all of a recording, every part of it, and say what of it is damaged. Status 1 where something is.

    A torn file is one that nobody closed: what was written before is whole. A recording that was written from a damaged
    one is whole itself, and what it lacks is said.
    """
    from annulus_pipe.record.missing import missing_told
    from annulus_pipe.record.recording import open_recording

    recording = open_recording(scan)
    damage, missing = recording.check(), missing_told(recording)
    if as_json:
        found = [{"offset": one.offset, "text": one.text, "messages": one.messages} for one in damage]
        content = {"frames": len(recording.frames), "torn": recording.torn, "cut_frames_at_most": recording.cut_frames}
        print(json.dumps({**content, "damage": found, **({"missing": missing} if missing else {})}))
    else:
        print(
            f"{len(recording.frames)} frames, {len(damage)} places damaged{_torn(recording.torn, recording.cut_frames)}"
        )
        for one in damage:
            lost = f", {one.messages} messages lost" if one.messages else ""
            print(f"{one.offset:>14}  {one.text}{lost}")
        for line in missing:
            print(f"{'missing':>14}  {line}")
    if damage or recording.torn:
        raise typer.Exit(1)


@app.command("recover", epilog="Example: annulus record recover torn.mcap -o whole.mcap")
def recover_command(
    scan: Scan,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="The new recording. [default: SCAN-recovered.mcap]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a whole recording, with an index, of all that can be read of a torn or damaged one, and say what was lost.

    Parts of a scan become one file. The original stays as it is. Ends with status 1 where something was lost.
    """
    from annulus_pipe.record.copy import recover
    from annulus_pipe.record.recording import open_recording

    new = out or scan.with_name(f"{scan.stem}-recovered.mcap")
    with progress() as bars:
        found = recover(open_recording(scan), new, bars)
    if as_json:
        print(json.dumps({"recording": str(new), **found.to_dict()}))
    else:
        print(f"{found.copied.frames} frames and {found.copied.notes} notes are in {new}")
        print(f"of {scan} {len(found.damage)} places are damaged{_torn(found.torn, found.cut_frames)}")
    _print_missing(scan, found.missing)
    if found.missing:
        raise typer.Exit(1)


@app.command(
    "export", epilog="Example: annulus record export scan.mcap -o scan --as png && annulus reconstruct scan .."
)
def export_command(
    scan: Scan,
    out: Annotated[Path, typer.Option("-o", "--out", help="New folder, or new .mcap.")],
    form: Annotated[
        str | None, typer.Option("--as", help="Pictures of a folder: png, jpeg. [default: png]", show_default=False)
    ] = None,
    codec: Annotated[
        str | None, typer.Option(help="Of a new recording: raw, zstd, jpeg. [default: as it is]", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Make a scan folder of a recording, pictures and frames.csv; or a recording that keeps its pictures otherwise.

    A folder's pictures are demosaiced, and frames whose place nobody knows are not in it. Ends with status 1 where the
    recording is torn or damaged, and says what was lost.
    """
    from annulus_pipe.record.codec import Codec
    from annulus_pipe.record.missing import missing_of, missing_told
    from annulus_pipe.record.recording import open_recording

    to_recording = out.suffix.lower() == ".mcap"
    if codec is not None and (not to_recording or codec not in list(Codec)):
        raise AnnulusError(f"--codec goes with a new .mcap and is one of {', '.join(Codec)}.")
    if form is not None and to_recording:
        raise AnnulusError("--as goes with a folder; a recording has --codec.")
    recording = open_recording(scan)
    lacks = missing_of(recording.torn, recording.cut_frames, recording.check())
    with progress() as bars:
        if to_recording:
            from annulus_pipe.record.copy import copy

            copied = copy(recording, out, codec=None if codec is None else Codec(codec), progress=bars)
            frames, without_place, damaged = copied.frames, 0, copied.damaged
        else:
            from annulus_pipe.scans.folder import export_folder

            exported = export_folder(recording, out, form or "png", bars)
            frames, without_place, damaged = exported.frames, exported.without_place, exported.damaged
    print_fields(
        {
            "out": str(out),
            "frames": frames,
            "without_place": without_place,
            "frames_damaged": len(damaged),
            "torn": recording.torn,
        },
        as_json,
    )
    lacks += damaged
    _print_missing(scan, lacks + missing_told(recording))
    if lacks or recording.torn:
        raise typer.Exit(1)


@app.command(
    "import",
    epilog="Example: annulus record import dvd.mp4 -o scan --chainage counter.csv && annulus reconstruct scan ..",
)
def import_command(
    video: Annotated[
        Path,
        typer.Argument(
            help="A video of a profiler head whose light stays on, AVI, MP4 ..; or a folder of its pictures, PNG .."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="New folder for the scan.")],
    chainage: Annotated[
        Path | None,
        typer.Option(
            help="CSV with columns frame (from 0) and chainage, chainage_m, chainage_ft ..; even between rows."
        ),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Of the chainage, where its heading names none: mm, cm, m, in, ft.")
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Of an even pull, mm/s, where no chainage is known.")] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.01, help="Frames a second, with --speed; the video's own if not given.")
    ] = None,
    first: Annotated[int, typer.Option(min=0, help="First frame.")] = 0,
    last: Annotated[int | None, typer.Option(min=0, help="Last frame; the video's if not given.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every n-th frame.")] = 1,
    as_json: Json = False,
) -> None:
    """Make a scan folder of a video, or of a folder of pictures: a picture a frame, and where it was taken.

    Pictures of a folder are counted from 0 in the order of their names; 9 comes before 10. Ends with status 1 where the
    video ends before it says.
    """
    from annulus_pipe.scans.video import UNITS_MM, import_video, read_chainage

    if (chainage is None) == (speed is None):
        raise AnnulusError("where were the frames? Expected either --chainage CSV or --speed MM_PER_S.")
    if fps is not None and speed is None:
        raise AnnulusError("--fps goes with --speed: a table of chainage names frames by number.")
    if unit is not None and (unit not in UNITS_MM or chainage is None):
        raise AnnulusError(f"--unit goes with --chainage and is one of {', '.join(UNITS_MM)}.")
    table = None if chainage is None else read_chainage(chainage, unit)
    with progress() as bars:
        made = import_video(
            video, out, chainage=table, speed_mm_s=speed, fps=fps, first=first, last=last, every=every, progress=bars
        )
    print_fields(
        {
            "scan": str(out),
            "frames": made.frames,
            "z_mm": list(made.z_mm),
            "without_place": made.without_place,
            "missing": made.missing,
            "pixel_aspect": made.aspect,
        },
        as_json,
    )
    if made.aspect != 1.0:
        print(
            f"annulus: {video}: its pixels are {made.aspect:.4g} times as wide as high; the pictures were stretched to "
            "square ones, and the calibration must be of such pictures too",
            file=sys.stderr,
        )
    if made.missing:
        print(
            f"annulus: {video}: ends {made.missing} frames before it says; it is cut short or damaged, and where it is "
            "damaged in the middle frames after that have the place of later ones",
            file=sys.stderr,
        )
        raise typer.Exit(1)


def _torn(torn: bool, cut_frames: int | None) -> str:
    if not torn:
        return ""
    if cut_frames == 0:
        return "; torn: it ends before it was closed, and in no frame"
    many = "an unknown number of frames" if cut_frames is None else f"{cut_frames} frame at most"
    return f"; torn: it ends before it was closed, and {many} with it"


def _print_missing(scan: Path, lines: list[str]) -> None:
    """What was written and cannot be read any more."""
    for line in lines[:LINES_MAX]:
        print(f"annulus: {scan}: {line}", file=sys.stderr)
    if len(lines) > LINES_MAX:
        print(f"annulus: {scan}: and {len(lines) - LINES_MAX} places more", file=sys.stderr)


def _print_table(found: dict[str, Any]) -> None:
    print(f"{found['frames']} frames, {found['changed']} change, {found['without_evidence']} without evidence")
    for row in found["changes"]:
        label = row["was"] if row["was"] == row["now"] else f"{row['was']} -> {row['now']}"
        print(f"{row['frames']:>8}  {row['what']:<6} {label:<24} {row['why']}")
