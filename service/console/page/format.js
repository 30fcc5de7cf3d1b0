// Figures as operators read them: value, sigma, unit, quality; never one without the others.

/** Digits that two digits of the sigma ask for. */
function digits(sigma) {
  if (!(sigma > 0)) return 2;
  return Math.min(3, Math.max(0, 1 - Math.floor(Math.log10(sigma))));
}

export function withSigma(value, sigma, unit) {
  if (value === null || value === undefined) return "–";
  if (!(sigma > 0)) return `${value.toFixed(2)} ${unit} ± ?`;
  const n = digits(sigma);
  return `${value.toFixed(n)} ± ${sigma.toFixed(n)} ${unit}`;
}

export function signed(value, n = 2) {
  return `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(n)}`;
}

/** Value and sigma in two sizes, into an element. */
export function putBig(element, value, sigma, unit) {
  if (value === null || value === undefined) {
    element.textContent = "–";
    return;
  }
  const n = Math.min(2, digits(sigma)), small = document.createElement("small");
  small.textContent = sigma > 0 ? ` ± ${sigma.toFixed(n)} ${unit}` : ` ± ? ${unit}`;
  element.replaceChildren(value.toFixed(n), small);
}

/** In words, a direction of the picture. */
export function parts(vector, unit, sign = 1) {
  if (!vector || vector[0] === null) return "";
  const [x, y] = vector.map((v) => v * sign);
  return `${x < 0 ? "left" : "right"} ${Math.abs(x).toFixed(2)}, ${y < 0 ? "up" : "down"} ${Math.abs(y).toFixed(2)} ${unit}`;
}

export function ago(seconds) {
  if (seconds < 100) return `${seconds.toFixed(seconds < 10 ? 1 : 0)} s`;
  if (seconds < 6000) return `${Math.floor(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

export function utc(epochMs) {
  return new Date(epochMs).toISOString().slice(11, 19);
}
