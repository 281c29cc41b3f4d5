"""Two wires of 0.6 mm in agar: what noise and pulse width do to telling them apart."""

from table import Row, keep

from annulus.tai.study import codes, wires
from annulus.tai.study.images import resolution


def rows() -> list[Row]:
    keep("fig8.13", wires.reference())
    found = keep("fig8.14", wires.pulse_widths())
    single, coded = found["separated 0.5 us"], found["separated 0.5 us MPSL25"]
    gain = codes.template().gain_db
    more = found["bears more with the code, dB"]
    sizes = resolution()
    worst = max(abs(a / b - 1) for a, b in zip(sizes.widths_mm, sizes.theory_mm, strict=True))
    return [
        Row(
            "2 kW, same noise: both wires separated (dip of 26.5 %), 0.5 us single", "not", "-", "<= 25 % of tries",
            f"{100 * single:.0f} %", single <= 0.25,
        ),
        Row("the same, 0.5 us MPSL25", "separated", "-", ">= 85 % of tries", f"{100 * coded:.0f} %", coded >= 0.85),
        Row("the same, 1 us single", "separated, noisy", "-", "-", f"{100 * found['separated 1 us']:.0f} %"),
        Row("the same, 2 us single", "one wire seen", "-", "-", f"{100 * found['separated 2 us']:.0f} %"),
        Row(
            "noise that leaves them separated one time in two: code over single", "-", f"{gain:.2f} dB",
            "within 1.5 dB of theory", f"{more:.1f} dB", abs(more - gain) <= 1.5,
        ),
        *(
            Row(
                f"width of a wire's image, pulse of {pulse:g} us, every frequency heard", "grows with the pulse",
                f"{theory:.2f} mm", "-", f"{width:.2f} mm",
            )
            for pulse, width, theory in zip(sizes.pulses_us, sizes.widths_mm, sizes.theory_mm, strict=True)
        ),
        Row("the largest departure of these from theory", "-", "0", "<= 5 %", f"{100 * worst:.1f} %", worst <= 0.05),
    ]  # fmt: skip


if __name__ == "__main__":
    for row in rows():
        print(row)
