"""What 50 angles are worth when nothing is noisy."""

from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study import images


def rows() -> list[Row]:
    found = keep("fig8.4", images.interpolation())
    orient = keep("fig7.4", images.transducer_orientation())
    return [
        Row(
            "50 angles, interpolated onto the circle, forward on the image's own grid",
            "-",
            "PSNR >= 31 dB, correlation >= 0.98",
            f"{found['psnr_same_grid_db']:.1f} dB, {found['correlation_same_grid']:.4f}",
            found["psnr_same_grid_db"] >= 31 and found["correlation_same_grid"] >= 0.98,
        ),
        Row(
            "the same, forward on a finer, shifted grid",
            "-",
            ">= 28 dB",
            f"{found['psnr_db']:.1f} dB, {found['correlation']:.4f}",
            found["psnr_db"] >= 28,
        ),
        Row(
            "from the 50 points alone, best scale",
            "blurred edges (Fig. 8.4b)",
            "-",
            f"{found['psnr_points_db']:.1f} dB, {found['correlation_points']:.3f}",
        ),
        Row(
            "line array, L-shaped array: correlation with the sample (Fig. 7.4)",
            "L sharper",
            "-",
            f"{orient['correlation_line']:.3f}, {orient['correlation_l']:.3f}",
        ),
    ]
