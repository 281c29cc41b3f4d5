// Numbers for people, as numeric/rounding.py has them and the report says them: kept with three decimals, rounded from
// those half away from zero, as decimals; an uncertainty up, and never 0. test_page.py holds both to one another.

export const DISTANCE = { unit: "m", places: 3, thousands: true };
export const MEASURE = { unit: "mm", places: 2 };
export const EXTENT = { unit: "mm", places: 0 };
export const ARC = { unit: "°", places: 0 };
export const ANGLE = { unit: "°", places: 1 };
export const PERCENT = { unit: "%", places: 2 };
export const SHARE = { unit: "%", places: 1 };
const STORED = 3;
const NOISE = 9;

// A finite number as [sign, digits, decimals]: its shortest decimal form, which is what Python's str() gives.
function decimal(value) {
  let text = String(Math.abs(value));
  let exponent = 0;
  const at = text.indexOf("e");
  if (at >= 0) {
    exponent = Number(text.slice(at + 1));
    text = text.slice(0, at);
  }
  const [whole, part = ""] = text.split(".");
  let digits = whole + part;
  let places = part.length - exponent;
  if (places < 0) {
    digits += "0".repeat(-places);
    places = 0;
  }
  return { negative: value < 0, digits: BigInt(digits), places };
}

function rounded(number, places, up) {
  if (number.places <= places) {
    return { ...number, digits: number.digits * 10n ** BigInt(places - number.places), places };
  }
  const unit = 10n ** BigInt(number.places - places);
  let digits = number.digits / unit;
  const rest = number.digits % unit;
  if (up ? rest > 0n && !number.negative : rest * 2n >= unit) digits += 1n;
  return { negative: number.negative, digits, places };
}

function text({ negative, digits, places }) {
  let written = String(digits).padStart(places + 1, "0");
  if (places > 0) written = `${written.slice(0, -places)}.${written.slice(-places)}`;
  return negative && digits !== 0n ? `-${written}` : written;
}

const scaled = (number, quantity) => (quantity.thousands ? { ...number, places: number.places + 3 } : number);

export function digits(value, quantity) {
  return text(rounded(scaled(rounded(decimal(value), STORED, false), quantity), quantity.places, false));
}

export function digitsK2(value, quantity) {
  const kept = rounded(rounded(decimal(value), NOISE, false), STORED, true);
  const up = rounded(scaled(kept, quantity), quantity.places, true);
  return text(up.digits > 0n && !up.negative ? up : { negative: false, digits: 1n, places: quantity.places });
}

const suffix = (quantity) => (quantity.unit === "°" || quantity.unit === "" ? quantity.unit : ` ${quantity.unit}`);
const known = (value) => typeof value === "number" && Number.isFinite(value);

// "2.28 ± 0.04 mm"; null where it was not measured: the page says so in its own language.
export function quoted(value, quantity, k2 = null, atLeast = false) {
  if (!known(value)) return null;
  const within = known(k2) ? ` ± ${digitsK2(k2, quantity)}` : "";
  return `${atLeast ? "≥ " : ""}${digits(value, quantity)}${within}${suffix(quantity)}`;
}

// 90 -> "3:00", to five minutes of the dial.
export function clockFace(angleDeg) {
  const turned = ((angleDeg % 360) + 360) % 360;
  const kept = rounded(decimal(turned), STORED, false);
  const step = 25n; // 2.5 degrees, in tenths
  const numerator = kept.digits * 10n;
  const unit = step * 10n ** BigInt(kept.places);
  let ticks = numerator / unit;
  if ((numerator % unit) * 2n >= unit) ticks += 1n;
  const tick = Number(ticks % 144n);
  return `${Math.floor(tick / 12) || 12}:${String((tick % 12) * 5).padStart(2, "0")}`;
}
