// The picture with the marks of its own frame, and which tube is where in it.

const NUMBERS = 9;
const STEPS_PER_PX = 8;
// Okabe and Ito's palette, as the 3D viewer has it: measured, predicted, plugged, absent. Shapes tell them apart first.
const COLORS = ["#78c3f0", "#e69f00", "#e182b9", "#c8c8c8"];
export const KINDS = ["measured", "predicted", "plugged", "absent"];

function ellipse(path, cx, cy, ux, uy, vx, vy, scale = 1) {
  // axes of c + u cos a + v sin a: half the length and width, and their direction
  const a = ux * ux + uy * uy, b = vx * vx + vy * vy, c = ux * vx + uy * vy;
  const turn = Math.atan2(2 * c, a - b) / 2;
  const cos = Math.cos(turn), sin = Math.sin(turn);
  const px = ux * cos + vx * sin, py = uy * cos + vy * sin;
  const qx = vx * cos - ux * sin, qy = vy * cos - uy * sin;
  const angle = Math.atan2(py, px);
  const long = Math.hypot(px, py) * scale, wide = Math.hypot(qx, qy) * scale;
  path.moveTo(cx + long * Math.cos(angle), cy + long * Math.sin(angle));
  path.ellipse(cx, cy, long, wide, angle, 0, 2 * Math.PI);
}

function stroke(pen, path, color, width, dash = [], halo = false) {
  pen.setLineDash(dash);
  if (halo) {
    pen.strokeStyle = "#000a";
    pen.lineWidth = width + 2;
    pen.stroke(path);
  }
  pen.strokeStyle = color;
  pen.lineWidth = width;
  pen.stroke(path);
  pen.setLineDash([]);
}

/** A tube's mark: a ring; predicted, a broken one; plugged, crossed out; absent, a small square dot. */
export function drawKind(pen, kind, paths) {
  if (kind === 0) stroke(pen, paths, COLORS[0], 1.3);
  else if (kind === 1) stroke(pen, paths, COLORS[1], 1.5, [5, 4]);
  else if (kind === 2) stroke(pen, paths, COLORS[2], 2);
  else stroke(pen, paths, COLORS[3], 2);
}

export function markOf(path, kind, cx, cy, ux, uy, vx, vy) {
  if (kind === 3) {
    path.rect(cx - 2, cy - 2, 4, 4);
    return;
  }
  ellipse(path, cx, cy, ux, uy, vx, vy);
  if (kind === 2) {
    const s = Math.SQRT1_2;
    for (const [p, q] of [[s, s], [s, -s]]) {
      path.moveTo(cx + p * ux + q * vx, cy + p * uy + q * vy);
      path.lineTo(cx - p * ux - q * vx, cy - p * uy - q * vy);
    }
  }
}

export class Picture {
  #canvas;
  #pen;
  #shown = null;

  constructor(canvas) {
    this.#canvas = canvas;
    this.#pen = canvas.getContext("2d", { alpha: false });
  }

  /** Draw a frame: its bitmap and its own marks at once. */
  draw(bitmap, head, marks) {
    const pen = this.#pen, [width, height] = head.size_px;
    const scale = this.#fit(width, height);
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.drawImage(bitmap, 0, 0, width, height);
    pen.translate(0.5, 0.5); // (0, 0) is the middle of the first pixel
    this.#shown = { head, marks };
    this.#drawMarks(head, marks);
    if (head.lock !== "full") this.#drawFrame(head, width, height);
  }

  /** Make the canvas as large as its place allows, a dot for a dot of the screen; gives dots a picture's pixel. */
  #fit(width, height) {
    const canvas = this.#canvas, { clientWidth: w, clientHeight: h } = canvas.parentElement;
    const scale = Math.min(w / width, h / height), dots = scale * devicePixelRatio;
    const [across, down] = [Math.round(width * dots), Math.round(height * dots)];
    if (canvas.width !== across || canvas.height !== down) {
      canvas.width = across;
      canvas.height = down;
      canvas.style.width = `${across / devicePixelRatio}px`;
      canvas.style.height = `${down / devicePixelRatio}px`;
    }
    return dots;
  }

  #drawMarks(head, marks) {
    const pen = this.#pen, paths = KINDS.map(() => new Path2D());
    pen.globalAlpha = head.lock === "full" ? 1 : 0.5;
    for (let i = 0; i < marks.length; i += NUMBERS) markOf(paths[marks[i + 6]], marks[i + 6], ...placeOf(marks, i));
    paths.forEach((path, kind) => drawKind(pen, kind, path));
    pen.globalAlpha = 1;
    if (head.target) this.#drawTarget(head, marks);
    if (head.alignment?.entry_px) this.#drawEntry(head.alignment.entry_px);
  }

  /** The target: corner brackets about a thick ring, with its name. */
  #drawTarget(head, marks) {
    const at = find(marks, head.target[0], head.target[1]);
    if (at < 0) return;
    const pen = this.#pen, [cx, cy, ux, uy, vx, vy] = placeOf(marks, at), path = new Path2D();
    const r = 1.45 * Math.max(Math.hypot(ux, uy), Math.hypot(vx, vy)), arm = 0.45 * r;
    for (const [sx, sy] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
      path.moveTo(cx + sx * r, cy + sy * (r - arm));
      path.lineTo(cx + sx * r, cy + sy * r);
      path.lineTo(cx + sx * (r - arm), cy + sy * r);
    }
    stroke(pen, path, "#fff", 2.6, [], true);
    const name = nameAt(head, head.target[0], head.target[1]);
    pen.font = "600 13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.lineWidth = 3.5;
    pen.strokeStyle = "#000c";
    pen.fillStyle = "#fff";
    const y = cy - r - 6 < 14 ? cy + r + 16 : cy - r - 6;
    pen.strokeText(name, cx, y);
    pen.fillText(name, cx, y);
  }

  /** Where the probe would hit: its outline, and a cross at its middle. */
  #drawEntry(px) {
    const pen = this.#pen, path = new Path2D(), cross = new Path2D();
    let x = 0, y = 0;
    for (let i = 0; i < px.length; i += 2) {
      path.lineTo(px[i], px[i + 1]);
      x += px[i] / (px.length / 2);
      y += px[i + 1] / (px.length / 2);
    }
    path.closePath();
    cross.moveTo(x - 7, y);
    cross.lineTo(x + 7, y);
    cross.moveTo(x, y - 7);
    cross.lineTo(x, y + 7);
    stroke(pen, path, "#fff", 1.6, [2, 2], true);
    stroke(pen, cross, "#fff", 1.6, [], true);
  }

  /** A lock that is not full frames the picture, and says why. */
  #drawFrame(head, width, height) {
    const pen = this.#pen, none = head.lock === "none";
    pen.strokeStyle = none ? "#d55e00" : "#e69f00";
    pen.lineWidth = 5;
    pen.setLineDash(none ? [14, 8] : []);
    pen.strokeRect(2, 2, width - 5, height - 5);
    pen.setLineDash([]);
    const text = `LOCK ${head.lock.toUpperCase()}${head.why ? `: ${head.why}` : ""}`;
    pen.font = "600 14px system-ui, sans-serif";
    pen.textAlign = "center";
    const wide = pen.measureText(text).width;
    pen.fillStyle = pen.strokeStyle;
    pen.fillRect(width / 2 - wide / 2 - 8, height - 24, wide + 16, 22);
    pen.fillStyle = "#000";
    pen.fillText(text, width / 2, height - 8);
  }

  /** The tube under a point of the screen; null where there is none. */
  tubeAt(clientX, clientY) {
    if (!this.#shown) return null;
    const box = this.#canvas.getBoundingClientRect(), { head, marks } = this.#shown;
    const x = ((clientX - box.left) / box.width) * head.size_px[0] - 0.5;
    const y = ((clientY - box.top) / box.height) * head.size_px[1] - 0.5;
    return this.#nearest(x, y, (i, d, r) => d <= 1.35 * r);
  }

  /** The tube beside the target in a direction of the picture, for the arrow keys. */
  tubeBeside(dx, dy) {
    if (!this.#shown) return null;
    const { head, marks } = this.#shown;
    const at = head.target ? find(marks, head.target[0], head.target[1]) : -1;
    if (at < 0) return this.#nearest(head.size_px[0] / 2, head.size_px[1] / 2, () => true);
    const [cx, cy] = placeOf(marks, at);
    let best = null, least = Infinity;
    for (let i = 0; i < marks.length; i += NUMBERS) {
      const [x, y] = placeOf(marks, i), along = (x - cx) * dx + (y - cy) * dy;
      const across = Math.abs((x - cx) * dy - (y - cy) * dx);
      if (i === at || along <= 0 || across > along * 1.05) continue;
      const cost = along + 2 * across;
      if (cost < least) [least, best] = [cost, i];
    }
    return best === null ? null : this.#tube(best);
  }

  #nearest(x, y, near) {
    const { marks } = this.#shown;
    let best = null, least = Infinity;
    for (let i = 0; i < marks.length; i += NUMBERS) {
      const [cx, cy, ux, uy, vx, vy] = placeOf(marks, i), d = Math.hypot(x - cx, y - cy);
      if (d < least && near(i, d, Math.max(Math.hypot(ux, uy), Math.hypot(vx, vy)))) [least, best] = [d, i];
    }
    return best === null ? null : this.#tube(best);
  }

  #tube(i) {
    const { head, marks } = this.#shown, [row, column] = [marks[i + 7], marks[i + 8]];
    return { row, column, kind: KINDS[marks[i + 6]], name: head.names?.[`${row},${column}`] ?? null, generation: head.generation, index: head.index };
  }
}

export function nameAt(head, row, column) {
  return head.names?.[`${row},${column}`] ?? `row ${row}, column ${column}`;
}

function placeOf(marks, i) {
  return [0, 1, 2, 3, 4, 5].map((k) => marks[i + k] / STEPS_PER_PX);
}

function find(marks, row, column) {
  for (let i = 0; i < marks.length; i += NUMBERS) if (marks[i + 7] === row && marks[i + 8] === column) return i;
  return -1;
}
