"""The label that belongs on a head, A6, to print: German and English. Numbers that only a measurement of this head
gives are blank lines to fill in.
"""

from html import escape

WIDTH, HEIGHT = 148, 105  # mm, A6 across
TEXTS = {
    "en": (
        "FLASHING LIGHT",
        (
            "Projector and LED ring flash with the camera: at 25 frames a second, 25 times a second.",
            "Light that flickers at 3 to 60 Hz can set off a seizure in people with photosensitive epilepsy.",
            "Do not look into the light. Arm the lamps in the pipe or behind a cover.",
        ),
        ("IEC 62471 risk group, projector:", "IEC 62471 risk group, LED ring:", "measured at mm, by, on:"),
    ),
    "de": (
        "BLITZENDES LICHT",
        (
            "Projektor und LED-Ring blitzen mit der Kamera: bei 25 Bildern je Sekunde 25-mal je Sekunde.",
            "Licht, das mit 3 bis 60 Hz flackert, kann bei Menschen mit photosensitiver Epilepsie einen Anfall"
            " auslösen.",
            "Nicht in das Licht blicken. Lampen nur im Rohr oder hinter einer Abdeckung scharf schalten.",
        ),
        (
            "Risikogruppe nach IEC 62471, Projektor:",
            "Risikogruppe nach IEC 62471, LED-Ring:",
            "gemessen bei mm, von, am:",
        ),
    ),
}


def _wrapped(text: str, size: int = 62) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) >= size:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def label(language: str) -> str:
    """An SVG of A6, in millimetres."""
    title, sentences, blanks = TEXTS[language]
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" lang="{language}" width="{WIDTH}mm" height="{HEIGHT}mm"'
        f' viewBox="0 0 {WIDTH} {HEIGHT}" role="img"><title>{escape(title)}</title>'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff" stroke="#000"/>'
        '<rect width="148" height="26" fill="#ffd500"/>'
        '<path d="M16 4 L28 23 L4 23 Z" fill="#ffd500" stroke="#000" stroke-width="1.4"/>'
        '<circle cx="16" cy="16.2" r="1.3"/>'  # light that goes out to all sides: ISO 7010's W027
        + "".join(
            f'<path d="M16 16.2 m0 -2.2 v-2.6" stroke="#000" transform="rotate({turn} 16 16.2)"/>'
            for turn in range(0, 360, 45)
        )
        + f'<text x="34" y="18" font-family="sans-serif" font-size="9.6" font-weight="bold">{escape(title)}</text>'
    ]
    y = 36.0
    for sentence in sentences:
        for line in _wrapped(sentence):
            out.append(f'<text x="6" y="{y:g}" font-family="sans-serif" font-size="4.2">{escape(line)}</text>')
            y += 5.6
        y += 2.0
    for number, blank in enumerate(blanks):
        at = HEIGHT - 22 + 8 * number
        out.append(f'<text x="6" y="{at}" font-family="sans-serif" font-size="3.8">{escape(blank)}</text>')
        out.append(f'<line x1="88" y1="{at + 0.8}" x2="142" y2="{at + 0.8}" stroke="#000" stroke-width="0.3"/>')
    return "\n".join([*out, "</svg>", ""])
