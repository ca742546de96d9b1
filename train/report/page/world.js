// One projection of the world: grid, obstacles, trails, robots.

const MARGIN = { left: 34, right: 10, top: 10, bottom: 24 };
const CONTACT_S = 0.25; // how long a contact is shown
const CONDITIONS = { crashed: 1, adversarial: 2, blind: 4, inactive: 8 };

/** Box of all robots and obstacles of these recordings, [[low, high], …] for each axis, with room. */
function boundsOf(recordings) {
  const [first, ...others] = recordings.map(({ extent }) => extent);
  const bounds = first.map(([low, high], axis) => [
    Math.min(low, ...others.map((extent) => extent[axis][0])),
    Math.max(high, ...others.map((extent) => extent[axis][1])),
  ]);
  const room = 0.08 * (Math.max(...bounds.map(([low, high]) => high - low)) || 1);
  return bounds.map(([low, high]) => [low - room, high + room]);
}

/** Pixels of metres on plane k of several pairs of axes, all of one scale. */
function projection(bounds, planes, k, width, height) {
  const axes = planes[k];
  const [[x0, x1], [y0, y1]] = axes.map((axis) => bounds[axis]);
  const w = width - MARGIN.left - MARGIN.right;
  const h = height - MARGIN.top - MARGIN.bottom;
  const extent = (axis) => bounds[axis][1] - bounds[axis][0];
  const scale = Math.min(...planes.map(([a, b]) => Math.min(w / extent(a), h / extent(b))));
  const [cx, cy] = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
  const [mx, my] = [MARGIN.left + 0.5 * w, MARGIN.top + 0.5 * h];
  return {
    axes,
    scale,
    x: (metres) => mx + scale * (metres - cx),
    y: (metres) => my - scale * (metres - cy),
    range: [
      [cx - (0.5 * w) / scale, cx + (0.5 * w) / scale],
      [cy - (0.5 * h) / scale, cy + (0.5 * h) / scale],
    ],
  };
}

/** Where a robot is at a time within frame k, interpolated for the eye: m, all axes. */
function place(rec, k, share, robot) {
  const [frames, robots, dim] = rec.shape.positions;
  const next = Math.min(k + 1, frames - 1);
  return Array.from({ length: dim }, (_, axis) => {
    const here = rec.positions[(k * robots + robot) * dim + axis];
    const there = rec.positions[(next * robots + robot) * dim + axis];
    return here + share * (there - here);
  });
}

/** Draw a recording at a moment {frame, share, time}; the chosen robot shows its directions. */
function drawWorld(canvas, rec, moment, bounds, planes, k, chosen) {
  const [pen, width, height] = prepare(canvas);
  const view = projection(bounds, planes, k, width, height);
  canvas.view = view;
  pen.font = "11px system-ui, sans-serif";
  drawGrid(pen, view, width, height);
  pen.save();
  pen.beginPath();
  pen.rect(MARGIN.left, MARGIN.top, width - MARGIN.left - MARGIN.right,
    height - MARGIN.top - MARGIN.bottom);
  pen.clip();
  drawObstacles(pen, view, rec, moment);
  const robots = rec.shape.positions[1];
  for (let robot = 0; robot < robots; robot++) drawTrail(pen, view, rec, moment, robot);
  const chosenLives = chosen !== null && isActive(rec, moment.frame, chosen);
  if (chosenLives) drawDirections(pen, view, rec, moment, chosen);
  for (let robot = 0; robot < robots; robot++)
    if (isActive(rec, moment.frame, robot)) drawRobot(pen, view, rec, moment, robot, chosen);
  pen.restore();
}

function isActive(rec, frame, robot) {
  return rec.active[frame * rec.shape.active[1] + robot] === 1;
}

/** True if a robot is crashed, adversarial, blind or inactive in a frame. */
function isIn(condition, rec, frame, robot) {
  if (!rec.conditions) return false;
  return (rec.conditions[frame * rec.shape.conditions[1] + robot] & CONDITIONS[condition]) !== 0;
}

function drawGrid(pen, view, width, height) {
  const [left, right] = [MARGIN.left, width - MARGIN.right];
  const [top, bottom] = [MARGIN.top, height - MARGIN.bottom];
  const step = niceStep(70 / view.scale);
  pen.strokeStyle = colour("grid");
  pen.fillStyle = colour("muted");
  pen.lineWidth = 1;
  const ticks = ([low, high]) => {
    const count = Math.floor(high / step) - Math.ceil(low / step) + 1;
    return Array.from({ length: count }, (_, k) => (Math.ceil(low / step) + k) * step);
  };
  pen.textAlign = "center";
  for (const value of ticks(view.range[0])) {
    line(pen, view.x(value), top, view.x(value), bottom);
    if (view.x(value) < right - 42) pen.fillText(tick(value), view.x(value), bottom + 14);
  }
  pen.textAlign = "right";
  for (const value of ticks(view.range[1])) {
    line(pen, left, view.y(value), right, view.y(value));
    if (view.y(value) > top + 18) pen.fillText(tick(value), left - 5, view.y(value) + 4);
  }
  pen.fillStyle = colour("ink");
  pen.fillText(`${"xyz"[view.axes[0]]} (m)`, right, bottom + 14);
  pen.textAlign = "left";
  pen.fillText(`${"xyz"[view.axes[1]]} (m)`, 4, top + 8);
}

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

/** Displacement of an outline at a moment from its place at the start: m, all axes. */
function shiftOf(rec, moment, outline) {
  if (!rec.obstacle_offsets) return [0, 0, 0];
  const [frames, outlines, dim] = rec.shape.obstacle_offsets;
  const next = Math.min(moment.frame + 1, frames - 1);
  const at = (frame, axis) => rec.obstacle_offsets[(frame * outlines + outline) * dim + axis];
  return Array.from({ length: dim }, (_, axis) => {
    const here = at(moment.frame, axis);
    return here + moment.share * (at(next, axis) - here);
  });
}

function drawObstacles(pen, view, rec, moment) {
  const [a, b] = view.axes;
  pen.fillStyle = colour("obstacle");
  pen.strokeStyle = colour("obstacle-edge");
  pen.lineWidth = 1;
  for (const [outline, { centre, radius, vertices }] of rec.obstacles.entries()) {
    const shift = shiftOf(rec, moment, outline);
    const [x, y] = [(at) => view.x(at[a] + shift[a]), (at) => view.y(at[b] + shift[b])];
    pen.beginPath();
    if (vertices.length) {
      for (const corner of vertices) pen.lineTo(x(corner), y(corner));
      pen.closePath();
    } else pen.arc(x(centre), y(centre), view.scale * radius, 0, 2 * Math.PI);
    pen.globalAlpha = centre.length === 3 ? 0.45 : 1; // spheres hide what is behind them
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
  }
}

function drawTrail(pen, view, rec, moment, robot) {
  const [, robots, dim] = rec.shape.positions;
  const at = (frame, axis) => rec.positions[(frame * robots + robot) * dim + axis];
  const [a, b] = view.axes;
  pen.strokeStyle = pen.fillStyle = robotColour(robot);
  pen.lineWidth = 1.6;
  pen.lineJoin = "round";
  pen.beginPath();
  pen.moveTo(view.x(at(0, a)), view.y(at(0, b)));
  let frame = 1;
  for (; frame <= moment.frame && isActive(rec, frame - 1, robot); frame++)
    pen.lineTo(view.x(at(frame, a)), view.y(at(frame, b)));
  const lives = isActive(rec, moment.frame, robot);
  if (lives) {
    const here = place(rec, moment.frame, moment.share, robot);
    pen.lineTo(view.x(here[a]), view.y(here[b]));
  }
  pen.stroke();
  pen.beginPath();
  pen.arc(view.x(at(0, a)), view.y(at(0, b)), 2.5, 0, 2 * Math.PI);
  pen.fill();
  if (!lives) cross(pen, view.x(at(frame - 1, a)), view.y(at(frame - 1, b)));
}

function cross(pen, x, y, arm = 4) {
  pen.strokeStyle = colour("ink");
  pen.lineWidth = arm > 4 ? 2.5 : 1.2;
  line(pen, x - arm, y - arm, x + arm, y + arm);
  line(pen, x - arm, y + arm, x + arm, y - arm);
}

function drawRobot(pen, view, rec, moment, robot, chosen) {
  const here = place(rec, moment.frame, moment.share, robot);
  const [x, y] = [view.x(here[view.axes[0]]), view.y(here[view.axes[1]])];
  const radius = rec.shape.positions[1] > 10 ? 6.5 : 8;
  const is = (condition) => isIn(condition, rec, moment.frame, robot);
  const fill = is("inactive") ? colour("muted") : robotColour(robot);
  if (is("crashed")) cross(pen, x, y, radius + 5);
  pen.fillStyle = fill;
  pen.strokeStyle = colour("paper");
  pen.lineWidth = 1.5;
  if (DATA.scenarios[rec.scenario].nonholonomic) {
    pen.save();
    pen.strokeStyle = fill;
    pen.lineWidth = 2.5;
    const axis = [0, 1].map((k) => frameOf(rec, moment.frame, robot)[view.axes[k]][0]);
    line(pen, x, y, x + 17 * axis[0], y - 17 * axis[1]);
    pen.restore();
  }
  pen.beginPath();
  if (is("adversarial")) pen.rect(x - radius, y - radius, 2 * radius, 2 * radius);
  else pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fill();
  pen.stroke();
  pen.fillStyle = onColour(fill);
  pen.textAlign = "center";
  pen.font = `600 ${radius + 2}px system-ui, sans-serif`;
  pen.fillText(robot, x, y + 0.36 * (radius + 2));
  if (is("blind")) {
    pen.setLineDash([3, 3]);
    ring(pen, x, y, radius + 3, colour("ink"), 1.5);
    pen.setLineDash([]);
  }
  if (robot === chosen) ring(pen, x, y, radius + 4, colour("ink"), 2);
  if (touched(rec, moment, robot)) ring(pen, x, y, radius + 7, colour("contact"), 3);
}

function ring(pen, x, y, radius, stroke, width) {
  pen.strokeStyle = stroke;
  pen.lineWidth = width;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.stroke();
}

/** Black or white, whichever reads on a colour. */
function onColour(hex) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  return 0.3 * r + 0.59 * g + 0.11 * b > 140 ? "#000000" : "#ffffff";
}

function touched(rec, moment, robot) {
  const robots = rec.shape.contacts[1];
  const before = Math.max(0, frameAt(rec.times, moment.time - CONTACT_S));
  const count = (frame) => rec.contacts[frame * robots + robot];
  return count(moment.frame) > count(before);
}

/** Rotation from a robot's own frame to the world, rows of numbers. */
function frameOf(rec, frame, robot) {
  const [, robots, dim] = rec.shape.positions;
  const start = (frame * robots + robot) * dim * dim;
  return Array.from({ length: dim }, (_, row) =>
    Array.from(rec.frames.subarray(start + row * dim, start + (row + 1) * dim)));
}

/** The chosen robot's axes, and its rows turned into the world by its recorded frame. */
function drawDirections(pen, view, rec, moment, robot) {
  const here = place(rec, moment.frame, moment.share, robot);
  const rotation = frameOf(rec, moment.frame, robot);
  const [x, y] = [view.x(here[view.axes[0]]), view.y(here[view.axes[1]])];
  const ray = (local, pixels) => {
    const length = Math.hypot(...local);
    return view.axes.map((axis) =>
      (pixels / length) * rotation[axis].reduce((sum, part, k) => sum + part * local[k], 0));
  };
  pen.lineWidth = 1.6;
  for (const { kind, vector, index } of rowsOf(rec, moment.frame, robot)) {
    if (kind === "own") continue;
    pen.strokeStyle = kind === "obstacle" ? colour("obstacle-edge") :
      index === null ? colour("accent") : robotColour(index);
    const [dx, dy] = ray(vector, kind === "obstacle" ? 70 : 46);
    pen.setLineDash(kind === "obstacle" ? [3, 3] : []);
    line(pen, x, y, x + dx, y - dy);
  }
  pen.setLineDash([]);
  rotation.forEach((_, k) => {
    const [dx, dy] = view.axes.map((axis) => 30 * rotation[axis][k]);
    pen.strokeStyle = pen.fillStyle = colour("ink");
    pen.lineWidth = 1.6;
    arrow(pen, x, y, dx, -dy, 6);
    pen.textAlign = "center";
    if (Math.hypot(dx, dy) > 8) pen.fillText("xyz"[k], x + 1.32 * dx, y - 1.32 * dy + 4);
  });
}

/** The active robot nearest to a point of the canvas, if it is within reach. */
function robotNear(canvas, rec, moment, px, py) {
  let [best, least] = [null, 18];
  for (let robot = 0; robot < rec.shape.positions[1]; robot++) {
    if (!isActive(rec, moment.frame, robot)) continue;
    const here = place(rec, moment.frame, moment.share, robot);
    const [a, b] = canvas.view.axes;
    const distance = Math.hypot(canvas.view.x(here[a]) - px, canvas.view.y(here[b]) - py);
    if (distance < least) [best, least] = [robot, distance];
  }
  return best;
}
