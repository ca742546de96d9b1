// Tables and recordings, as they lie in the page.

const DATA = JSON.parse(document.getElementById("data").textContent);
const decoded = new Map();

/** A recording by its number, decoded on first use: promise of {name: array, shape: {name}}. */
function recording(number) {
  if (!decoded.has(number)) decoded.set(number, decode(number));
  return decoded.get(number);
}

async function decode(number) {
  const text = document.getElementById(`recording-${number}`).textContent;
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const found = { shape: {}, ...DATA.recordings[number] };
  let at = 0;
  for (const [name, type, shape, scale] of DATA.recordings[number].fields) {
    const count = shape.reduce((a, b) => a * b, 1);
    const size = { float32: 4, int16: 2, uint8: 1 }[type] * count;
    found[name] = READERS[type](bytes.slice(at, at + size), shape[0], scale);
    found.shape[name] = shape;
    at += size;
  }
  found.obstacles = DATA.obstacles[found.obstacles];
  if (found.angles) rowsFromAngles(found);
  return found;
}

/** In the plane a row comes as its length and its angle, a neighbour's from where it truly stands. */
function rowsFromAngles(found) {
  const [frames, robots, rows] = found.shape.angles;
  found.observations = new Float32Array(2 * found.angles.length);
  for (let frame = 0, at = 0; frame < frames; frame++)
    for (let robot = 0; robot < robots; robot++)
      for (let row = 0; row < rows; row++, at++) {
        const length = found.lengths[at];
        if (length === 0) continue;
        const other = row + (row >= robot);
        const base = other < robots ? bearing(found, frame, robot, other) : 0;
        found.observations[2 * at] = length * Math.cos(base + found.angles[at]);
        found.observations[2 * at + 1] = length * Math.sin(base + found.angles[at]);
      }
  found.shape.observations = [...found.shape.angles, 2];
}

/** Angle at which a robot in the plane has another in its own frame. */
function bearing({ positions, frames, shape }, frame, robot, other) {
  const [own, its] = [robot, other].map((k) => 2 * (frame * shape.positions[1] + k));
  const [x, y] = [0, 1].map((axis) => positions[its + axis] - positions[own + axis]);
  const [a, b, c, d] = frames.subarray(2 * own, 2 * own + 4);
  return Math.atan2(b * x + d * y, a * x + c * y);
}

const READERS = {
  uint8: (bytes) => bytes,
  float32: (bytes) => new Float32Array(bytes.buffer),
  int16: fromDifferences,
};

/** Undo train/report/encoding.py: low bytes, then high bytes, of differences in time. */
function fromDifferences(bytes, frames, scale) {
  const count = bytes.length / 2;
  const width = count / frames;
  const values = new Float32Array(count);
  for (let column = 0; column < width; column++) {
    let sum = 0;
    for (let frame = 0; frame < frames; frame++) {
      const place = column * frames + frame;
      sum = ((sum + bytes[place] + 256 * bytes[count + place]) << 16) >> 16;
      values[frame * width + column] = sum === -32768 ? NaN : sum * scale;
    }
  }
  return values;
}

/** Number of the last frame at or before a time. */
function frameAt(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time + 1e-6) low = middle;
    else high = middle - 1;
  }
  return low;
}

const find = (id) => document.getElementById(id);

/** An element with properties and children. */
function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** A colour of page.css, light or dark as the reader prefers. */
function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** The colour of a robot; black ones are drawn in the colour of the text. */
function robotColour(robot) {
  const own = DATA.robot_colours[robot % DATA.robot_colours.length];
  return own === "#000000" ? colour("ink") : own;
}

/** A canvas ready to be drawn on, [context, width, height] in CSS pixels. */
function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return [pen, width, height];
}

/** An arrow from (x, y) by (dx, dy) pixels. */
function arrow(pen, x, y, dx, dy, head = 7) {
  const length = Math.hypot(dx, dy);
  if (length < 1) return;
  const [ux, uy] = [dx / length, dy / length];
  const back = Math.min(head, length);
  pen.beginPath();
  pen.moveTo(x, y);
  pen.lineTo(x + dx - 0.6 * back * ux, y + dy - 0.6 * back * uy);
  pen.stroke();
  pen.beginPath();
  pen.moveTo(x + dx, y + dy);
  pen.lineTo(x + dx - back * ux - 0.45 * back * uy, y + dy - back * uy + 0.45 * back * ux);
  pen.lineTo(x + dx - back * ux + 0.45 * back * uy, y + dy - back * uy - 0.45 * back * ux);
  pen.fill();
}
