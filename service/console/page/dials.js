// The bull's-eye and the bubble level, and the trends: drawn, with their limits.

const INK = "#14171a", SOFT = "#5b6165", FAINT = "#9aa0a4", FACE = "#e6e8e9";

/** Make a canvas as sharp as the screen; gives its pen, width and height in CSS pixels. */
function prepare(canvas) {
  const w = canvas.clientWidth, h = canvas.clientHeight, r = devicePixelRatio;
  if (canvas.width !== Math.round(w * r) || canvas.height !== Math.round(h * r)) {
    canvas.width = Math.round(w * r);
    canvas.height = Math.round(h * r);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(r, 0, 0, r, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = `${Math.max(10.5, h / 17)}px system-ui, sans-serif`;
  return [pen, w, h];
}

function ring(pen, c, r, color, width, dash = []) {
  pen.beginPath();
  pen.arc(c, c, r, 0, 2 * Math.PI);
  pen.setLineDash(dash);
  pen.strokeStyle = color;
  pen.lineWidth = width;
  pen.stroke();
  pen.setLineDash([]);
}

/** The range that shows both limits, or where the value is beyond them the next that shows it. */
function rangeFor(value, limit) {
  let range = 1.6 * limit;
  while (value > range && range < 200 * limit) range *= 2;
  return range;
}

export class Dial {
  #canvas;
  #trail = [];
  #level;

  /** `level`: a bubble level, else a bull's-eye. */
  constructor(canvas, level) {
    this.#canvas = canvas;
    this.#level = level;
  }

  /** value: [right, down] in the picture; spread: covariance [xx, xy, yx, yy]; limits: two rings; null: none. */
  draw(value, spread, limits, unit, missing) {
    const [pen, w] = prepare(this.#canvas), c = w / 2, most = c - 2;
    pen.beginPath();
    pen.arc(c, c, most, 0, 2 * Math.PI);
    pen.fillStyle = FACE;
    pen.fill();
    ring(pen, c, most, SOFT, 1.5);
    if (!value || value[0] === null) {
      this.#trail = [];
      this.#words(pen, c, missing);
      return;
    }
    const far = Math.hypot(...value), range = rangeFor(far, limits[1]), scale = most / range;
    this.#face(pen, c, most, scale, limits, unit, value[1] < 0 ? 1 : -1);
    const [x, y] = [c + value[0] * scale, c + value[1] * scale];
    this.#trail.push([value[0], value[1]]);
    if (this.#trail.length > 90) this.#trail.shift();
    this.#drawTrail(pen, c, scale);
    if (this.#level) this.#bubble(pen, x, y, most, far, limits);
    else this.#mark(pen, c, x, y, most, scale, spread, far, limits);
  }

  #words(pen, c, text) {
    pen.fillStyle = SOFT;
    pen.textAlign = "center";
    (text ?? "").split("\n").forEach((line, i, all) => pen.fillText(line, c, c + 4 + 16 * (i - (all.length - 1) / 2)));
  }

  #face(pen, c, most, scale, limits, unit, free) {
    pen.beginPath();
    pen.moveTo(c - most, c);
    pen.lineTo(c + most, c);
    pen.moveTo(c, c - most);
    pen.lineTo(c, c + most);
    pen.strokeStyle = FAINT;
    pen.lineWidth = 1;
    pen.stroke();
    ring(pen, c, limits[0] * scale, INK, 1.6);
    ring(pen, c, limits[1] * scale, INK, 1.6, [5, 4]);
    pen.fillStyle = INK;
    pen.textAlign = "center";
    if (limits[1] * scale < 0.3 * most) pen.fillText(`to ${+(most / scale).toPrecision(2)} ${unit === "deg" ? "°" : unit}`, c, c + 4 + free * most * 0.72);
    pen.textAlign = "left";
    limits.forEach((limit) => {
      const at = limit * scale * Math.SQRT1_2;
      if (limit * scale > 14) pen.fillText(`${limit}${unit === "deg" ? "°" : ""}`, c + at + 3, c - at - 1);
    });
  }

  #drawTrail(pen, c, scale) {
    pen.beginPath();
    this.#trail.forEach(([x, y]) => pen.lineTo(c + x * scale, c + y * scale));
    pen.strokeStyle = "#14171a55";
    pen.lineWidth = 1.2;
    pen.stroke();
  }

  #mark(pen, c, x, y, most, scale, spread, far, limits) {
    if (spread && spread[0] !== null) {
      // two sigmas: 86 % of the places where it may be
      const [a, b, , d] = spread, mean = (a + d) / 2, half = Math.hypot((a - d) / 2, b);
      pen.beginPath();
      pen.ellipse(x, y, Math.max(1, 2 * Math.sqrt(Math.max(0, mean + half)) * scale),
        Math.max(1, 2 * Math.sqrt(Math.max(0, mean - half)) * scale), Math.atan2(2 * b, a - d) / 2, 0, 2 * Math.PI);
      pen.save();
      pen.clip(this.#circle(c, most));
      pen.fillStyle = "#0f5fae55";
      pen.fill();
      pen.restore();
    }
    const s = most * 0.13;
    pen.beginPath();
    pen.moveTo(x - s, y);
    pen.lineTo(x + s, y);
    pen.moveTo(x, y - s);
    pen.lineTo(x, y + s);
    pen.strokeStyle = INK;
    pen.lineWidth = 3;
    pen.stroke();
    pen.beginPath();
    pen.arc(x, y, s * 0.55, 0, 2 * Math.PI);
    pen.stroke();
    this.#beyond(pen, x, y, s, far, limits);
  }

  #circle(c, r) {
    const path = new Path2D();
    path.arc(c, c, r, 0, 2 * Math.PI);
    return path;
  }

  #bubble(pen, x, y, most, far, limits) {
    const r = most * 0.15;
    pen.beginPath();
    pen.arc(x, y, r, 0, 2 * Math.PI);
    pen.fillStyle = "#fff";
    pen.fill();
    pen.strokeStyle = INK;
    pen.lineWidth = 3;
    pen.stroke();
    pen.beginPath();
    pen.arc(x, y, 2, 0, 2 * Math.PI);
    pen.fillStyle = INK;
    pen.fill();
    this.#beyond(pen, x, y, r, far, limits);
  }

  /** Beyond a limit the mark wears its shape: a triangle, beyond the second an octagon. */
  #beyond(pen, x, y, s, far, limits) {
    if (limits.plain || far <= limits[0]) return;
    const corners = far <= limits[1] ? 3 : 8, r = s * 1.7, turn = corners === 3 ? -Math.PI / 2 : Math.PI / 8;
    pen.beginPath();
    for (let i = 0; i < corners; i++) {
      const a = turn + (i * 2 * Math.PI) / corners;
      pen.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
    }
    pen.closePath();
    pen.strokeStyle = corners === 3 ? "#c27f00" : "#b3101c";
    pen.lineWidth = 3.5;
    pen.stroke();
  }
}

const SPAN_MS = 60000;

/** The last minute: value, band of one sigma, limits; a gap where nothing was measured. */
export function drawTrend(canvas, points, field, title, unit, limits, nowMs) {
  const [pen, w, h] = prepare(canvas), left = 46, right = w - 6, top = 5, bottom = h - 15;
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = FACE;
  pen.fillRect(left, top, right - left, bottom - top);
  const known = points.filter((p) => p[field] !== null && p[0] > nowMs - SPAN_MS);
  const [low, high] = span(known, field, limits);
  const x = (t) => right - ((nowMs - t) / SPAN_MS) * (right - left);
  const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
  pen.save();
  pen.beginPath();
  pen.rect(left, top, right - left, bottom - top);
  pen.clip();
  band(pen, runs(points, field, nowMs), field, x, y);
  pen.setLineDash([5, 4]);
  pen.strokeStyle = "#b3101c";
  pen.lineWidth = 1.2;
  for (const limit of limits) line(pen, [[left, y(limit)], [right, y(limit)]]);
  pen.setLineDash([]);
  pen.restore();
  scale(pen, left, right, top, bottom, low, high, title, unit, limits, y);
}

function span(known, field, limits) {
  const values = known.map((p) => p[field]);
  // what is far off would squeeze the limits to nothing: it leaves at the top
  const last = limits[limits.length - 1];
  if (limits.length) return [0, Math.min(4 * last, Math.max(1.3 * last, ...values.map((v) => v * 1.1)))];
  if (!values.length) return [0, 1];
  const low = Math.min(...values), high = Math.max(...values), margin = Math.max(0.15 * (high - low), 0.02 * Math.abs(high), 1e-3);
  return [low - margin, high + margin];
}

function runs(points, field, nowMs) {
  const out = [];
  let run = [];
  for (const p of points) {
    if (p[0] < nowMs - SPAN_MS) continue;
    const broken = p[field] === null || (run.length && p[0] - run[run.length - 1][0] > 1000);
    if (broken && run.length) out.push(run), (run = []);
    if (p[field] !== null) run.push(p);
  }
  if (run.length) out.push(run);
  return out;
}

function band(pen, all, field, x, y) {
  for (const run of all) {
    pen.beginPath();
    run.forEach((p) => pen.lineTo(x(p[0]), y(p[field] + (p[field + 1] ?? 0))));
    [...run].reverse().forEach((p) => pen.lineTo(x(p[0]), y(p[field] - (p[field + 1] ?? 0))));
    pen.closePath();
    pen.fillStyle = "#14171a30";
    pen.fill();
    pen.strokeStyle = INK;
    pen.lineWidth = 1.8;
    line(pen, run.map((p) => [x(p[0]), y(p[field])]));
  }
}

function line(pen, points) {
  pen.beginPath();
  points.forEach(([x, y]) => pen.lineTo(x, y));
  pen.stroke();
}

/** Of growing values those that are not too close to the one before. */
function apart(values, gap) {
  const kept = [];
  for (const v of values) if (!kept.length || v - kept[kept.length - 1] > gap) kept.push(v);
  return kept;
}

function scale(pen, left, right, top, bottom, low, high, title, unit, limits, y) {
  pen.strokeStyle = SOFT;
  pen.lineWidth = 1;
  pen.strokeRect(left, top, right - left, bottom - top);
  pen.fillStyle = INK;
  pen.textAlign = "right";
  const digits = high - low < 1 ? 2 : high - low < 10 ? 1 : 0;
  const gap = (12 * (high - low)) / (bottom - top);
  const told = limits.length ? apart([0, ...limits], gap) : [low, high];
  for (const v of told) {
    pen.fillText(v.toFixed(limits.length ? Math.min(2, digits + 1) : digits), left - 4, Math.min(bottom, Math.max(top + 8, y(v) + 4)));
  }
  pen.textAlign = "left";
  pen.fillText(`${title}, ${unit}`, left + 4, top + 12);
  pen.fillStyle = SOFT;
  pen.fillText("−60 s", left, bottom + 12);
  pen.textAlign = "right";
  pen.fillText("now", right, bottom + 12);
}
