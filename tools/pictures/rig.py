"""Draws tools/pictures/rig.svg, the jumpers between a controller and its rig: `python -m tools.pictures.rig`."""

from pathlib import Path

from annulus_pipe.selftest.rig.wiring import NAMES, NEEDED, OPTIONAL

OUT = Path(__file__).with_name("rig.svg")
WIDTH, ROW, TOP, BOARD = 760, 26, 70, 170
GROUND = 3  # pin of the edge: one of eight that are ground
INK, NEEDED_INK, OPTIONAL_INK = "#222", "#b3261e", "#4a6fa5"


def edge(pin: int) -> int:
    """Number on the Pico's edge."""
    return pin + 1 + (pin + 2) // 4


def rows() -> list[tuple[int, str, str, bool]]:
    """(edge pin, GP or GND, what, needed) from the USB socket down."""
    pins = [(edge(pin), f"GP{pin}", NAMES[pin], pin in NEEDED) for pin in (*NEEDED, *OPTIONAL)]
    return sorted([*pins, (GROUND, "GND", "ground", True)])


def drawn() -> str:
    lines = rows()
    height = TOP + ROW * len(lines) + 60
    left, right = 40 + BOARD, WIDTH - 40 - BOARD
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
        ' font-family="sans-serif" font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
    ]
    for x, title, image in ((40, "controller", "annulus.uf2"), (right, "rig", "rig.uf2")):
        middle = x + BOARD / 2
        out += [
            f'<rect x="{x}" y="30" width="{BOARD}" height="{height - 60}" rx="8" fill="#e8f3ea" stroke="{INK}"/>',
            f'<rect x="{middle - 24}" y="18" width="48" height="22" rx="3" fill="#ccc" stroke="{INK}"/>',
            f'<text x="{middle}" y="34" text-anchor="middle" fill="{INK}">USB</text>',
            f'<text x="{middle}" y="58" text-anchor="middle" font-weight="bold" fill="{INK}">{title}, {image}</text>',
        ]
    for i, (number, name, what, is_needed) in enumerate(lines):
        y = TOP + ROW * i + 16
        ink, dash = (NEEDED_INK, "") if is_needed else (OPTIONAL_INK, ' stroke-dasharray="6 4"')
        out += [
            f'<line x1="{left}" y1="{y}" x2="{right}" y2="{y}" stroke="{ink}" stroke-width="2.5"{dash}/>',
            f'<circle cx="{left}" cy="{y}" r="4" fill="{ink}"/><circle cx="{right}" cy="{y}" r="4" fill="{ink}"/>',
            f'<text x="{left - 12}" y="{y + 4}" text-anchor="end" fill="{INK}">{name}, pin {number}</text>',
            f'<text x="{right + 12}" y="{y + 4}" fill="{INK}">{name}, pin {number}</text>',
            f'<text x="{WIDTH / 2}" y="{y - 4}" text-anchor="middle" fill="{ink}">{what}</text>',
        ]
    y = height - 14
    out += [
        f'<text x="40" y="{y}" fill="{NEEDED_INK}">solid: the eight that are needed</text>',
        f'<text x="{WIDTH - 40}" y="{y}" text-anchor="end" fill="{OPTIONAL_INK}">dashed: eight more, for every'
        " promise</text>",
        "</svg>",
    ]
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    OUT.write_text(drawn(), encoding="utf-8")
