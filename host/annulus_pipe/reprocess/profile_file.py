"""The profiles of a range of frames as one Parquet file, and back, the same to the bit.

A row a profile; what a profile has of every point is a list in its row. Names end in the unit, and every column's
metadata says it again. What the range's frames say besides (`about`, JSON) is in the file's own metadata, with a
SHA-256 over it and all columns: a file is either all that was written, or it is not read.
"""

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.extras import need
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

FORMAT = 1
ABOUT, DIGEST = b"annulus.range", b"annulus.sha256"
ROWS_MAX = 1 << 16  # profiles of a file
_POINT = {  # of each point: column, numpy type, unit
    "x_mm": ("<f4", "mm"),
    "y_mm": ("<f4", "mm"),
    "z_mm_of_points": ("<f4", "mm"),
    "red": ("u1", "grey level"),
    "green": ("u1", "grey level"),
    "blue": ("u1", "grey level"),
    "ring": ("u1", "number, innermost 0"),
    "direction": ("<u2", "number of the polar direction"),
    "sigma_mm": ("<f4", "mm"),
    "seen_by": ("u1", "camera id, or the number of cameras"),
}
_RING = {"ring_drawn_mm": ("<f4", "mm"), "ring_alone_mm": ("<f4", "mm")}  # of each ring
_SLIT = {"slit_rad": ("<f4", "rad")}
_FRAME = {
    "frame": ("<i8", "index"),
    "camera": ("u1", "id"),
    "z_mm": ("<f8", "mm"),
    "residual_mm": ("<f8", "mm"),
    "lean_sigma_deg": ("<f8", "degrees"),
}
_POSE = {"rx_rad": "rad", "ry_rad": "rad", "tx_mm": "mm", "ty_mm": "mm", "roll_rad": "rad"}  # null where unknown
_NAMED = {"rejected": ("<i8", "slits"), "timing_ms": ("<f8", "ms")}


def packed(profiles: Sequence[Profile], about: Mapping[str, Any]) -> bytes:
    """A Parquet file of them. `about` is JSON: what else is to be known of the range."""
    arrow, parquet = need("pyarrow"), need("pyarrow.parquet")
    arrays, fields = [], []
    for name, unit, array in _columns(arrow, profiles):
        fields.append(arrow.field(name, array.type, metadata={b"unit": unit.encode()}))
        arrays.append(array)
    header = json.dumps({"format": FORMAT, **about}, sort_keys=True).encode()
    metadata = {ABOUT: header, DIGEST: _digest(header, profiles).encode()}
    table = arrow.Table.from_arrays(arrays, schema=arrow.schema(fields, metadata=metadata))
    out = io.BytesIO()
    # No dictionaries: they would take one NaN for another.
    parquet.write_table(
        table,
        out,
        row_group_size=max(1, len(profiles)),
        use_dictionary=False,
        compression="zstd",
        compression_level=1,
        write_page_checksum=True,
    )
    return out.getvalue()


def unpacked(data: bytes, where: str) -> tuple[tuple[Profile, ...], Mapping[str, Any]]:
    """Profiles and `about` of such a file. Raises AnnulusError, one line, for anything that `packed` did not write."""
    arrow, parquet = need("pyarrow"), need("pyarrow.parquet")
    try:
        file = parquet.ParquetFile(io.BytesIO(data), page_checksum_verification=True)
        if file.metadata.num_rows > ROWS_MAX:
            raise ValueError(f"{file.metadata.num_rows} rows, expected at most {ROWS_MAX}")
        table = file.read()
        header = (table.schema.metadata or {})[ABOUT]
        about = json.loads(header)
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise ValueError(f"not of format {FORMAT}")
        profiles = _profiles(table)
        for profile in profiles:
            Profile.from_dict(profile.to_dict())  # what a stranger wrote is checked as on the wire
        if _digest(header, profiles).encode() != table.schema.metadata[DIGEST]:
            raise ValueError("its checksum is wrong")
    except (arrow.ArrowException, OSError, KeyError, ValueError, TypeError, RecursionError) as error:
        why = str(error).partition("\n")[0]
        raise AnnulusError(f"{where}: not the profiles of a range as annulus writes them: {why}.") from None
    return profiles, about


def _columns(arrow: Any, profiles: Sequence[Profile]) -> list[tuple[str, str, Any]]:
    out: list[tuple[str, str, Any]] = []
    for name, (kind, unit) in _FRAME.items():
        out.append((name, unit, arrow.array(np.array([getattr(p, name) for p in profiles], kind))))
    for (name, unit), field in zip(_POSE.items(), ("rx", "ry", "tx", "ty", "roll"), strict=True):
        values = [None if p.pose is None else getattr(p.pose, field) for p in profiles]
        out.append((name, unit, arrow.array(values, arrow.float64())))
    parts = [_parts(profile) for profile in profiles]
    for name, (kind, unit) in {**_POINT, **_RING, **_SLIT}.items():
        rows = [np.ascontiguousarray(part[name], kind) for part in parts]
        ends = np.cumsum([0, *map(len, rows)], dtype=np.int32)
        flat = np.concatenate([np.zeros(0, kind), *rows])
        out.append((name, unit, arrow.ListArray.from_arrays(arrow.array(ends), arrow.array(flat))))
    for name, (kind, unit) in _NAMED.items():
        of = arrow.map_(arrow.string(), arrow.from_numpy_dtype(np.dtype(kind)))
        out.append((name, unit, arrow.array([list(getattr(p, name).items()) for p in profiles], of)))
    return out


def _parts(profile: Profile) -> dict[str, NDArray[Any]]:
    points, colour, of_rings = profile.points_mm, profile.colour, profile.ring_sigma_mm
    return {
        "x_mm": points[:, 0],
        "y_mm": points[:, 1],
        "z_mm_of_points": points[:, 2],
        "red": colour[:, 0],
        "green": colour[:, 1],
        "blue": colour[:, 2],
        "ring": profile.ring,
        "direction": profile.direction,
        "sigma_mm": profile.sigma_mm,
        "seen_by": profile.seen_by,
        "ring_drawn_mm": of_rings[:, 0],
        "ring_alone_mm": of_rings[:, 1],
        "slit_rad": profile.slit_rad,
    }


def _profiles(table: Any) -> tuple[Profile, ...]:
    flat = {name: table.column(name).to_pylist() for name in (*_FRAME, *_POSE, *_NAMED)}
    lists: dict[str, list[NDArray[Any]]] = {}
    for name, (kind, _) in {**_POINT, **_RING, **_SLIT}.items():
        column = table.column(name).combine_chunks()
        ends = np.asarray(column.offsets)
        values = np.asarray(column.values).astype(kind, casting="equiv")
        lists[name] = [values[a:b] for a, b in pairwise(ends)]
    out = []
    for row in range(table.num_rows):
        one = {name: values[row] for name, values in flat.items()}
        of = {name: values[row] for name, values in lists.items()}
        pose = None if one["rx_rad"] is None else Pose(*(one[name] for name in _POSE))
        out.append(
            Profile(
                one["frame"],
                one["z_mm"],
                pose,
                np.stack([of["x_mm"], of["y_mm"], of["z_mm_of_points"]], axis=1),
                np.stack([of["red"], of["green"], of["blue"]], axis=1),
                of["ring"].copy(),
                of["direction"].copy(),
                one["residual_mm"],
                dict(one["rejected"]),
                dict(one["timing_ms"]),
                of["sigma_mm"].copy(),
                one["lean_sigma_deg"],
                one["camera"],
                np.stack([of["ring_drawn_mm"], of["ring_alone_mm"]], axis=1),
                of["seen_by"].copy(),
                of["slit_rad"].copy(),
            )
        )
    return tuple(out)


def _digest(about: bytes, profiles: Sequence[Profile]) -> str:
    digest = hashlib.sha256(about)
    for p in profiles:
        pose = p.pose and (p.pose.rx, p.pose.ry, p.pose.tx, p.pose.ty, p.pose.roll)
        rest = (p.frame, p.camera, p.z_mm, pose, p.residual_mm, p.lean_sigma_deg, dict(p.rejected), dict(p.timing_ms))
        digest.update(repr(rest).encode())
        arrays = (p.points_mm, p.colour, p.ring, p.direction, p.sigma_mm, p.ring_sigma_mm, p.seen_by, p.slit_rad)
        for array in arrays:
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()
