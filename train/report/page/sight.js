// Observation of one robot: recorded rows, and true bearings for imperfect sensors.

/** Rows present at a frame: {kind, index, point, vector}; absent ones, all zero, are left out. */
function rowsOf(rec, frame, robot) {
  const [, robots, rows, dim] = rec.shape.observations;
  const { neighbour_slots: slots, rows_per_obstacle: points, obstacle_slots: obstacles } =
    DATA.scenarios[rec.scenario];
  const found = [];
  for (let row = 0; row < rows; row++) {
    const start = ((frame * robots + robot) * rows + row) * dim;
    const vector = Array.from(rec.observations.subarray(start, start + dim));
    if (vector.every((part) => part === 0)) continue;
    const slot = row - slots;
    if (slot < 0) {
      const index = slots === robots - 1 ? row + (row >= robot) : seenIn(rec, frame, robot, vector);
      found.push({ kind: "neighbour", index, vector });
    } else if (slot < obstacles * points)
      found.push({
        kind: "obstacle", index: Math.floor(slot / points), point: slot % points, vector,
      });
    else found.push({ kind: "own", index: 0, vector });
  }
  return found;
}

/** Which robot stands in a direction, where rows do not say it; null if the sensor errs. */
function seenIn(rec, frame, robot, vector) {
  if (!DATA.scenarios[rec.scenario].exact) return null;
  const along = ({ direction }) => direction.reduce((sum, x, k) => sum + x * vector[k], 0);
  const others = trueDirections(rec, frame, robot);
  return others.reduce((a, b) => (along(b) > along(a) ? b : a)).index;
}

/** Unit directions {index, direction}, in the robot's own frame, in which the others truly stand. */
function trueDirections(rec, frame, robot) {
  const [, robots, dim] = rec.shape.positions;
  const rowsFrom = (array, j, size) =>
    array.subarray((frame * robots + j) * size, (frame * robots + j + 1) * size);
  const own = rowsFrom(rec.positions, robot, dim);
  const turn = rowsFrom(rec.frames, robot, dim * dim);
  const found = [];
  for (let j = 0; j < robots; j++) {
    if (j === robot || !isActive(rec, frame, j)) continue;
    const offset = Array.from(rowsFrom(rec.positions, j, dim), (x, k) => x - own[k]);
    const length = Math.hypot(...offset);
    if (length > 0)
      found.push({
        index: j,
        direction: offset.map((_, axis) =>
          offset.reduce((sum, x, k) => sum + turn[k * dim + axis] * x, 0) / length),
      });
  }
  return found;
}

/** Silhouette rows by obstacle. */
function silhouettes(rows) {
  const found = new Map();
  for (const row of rows.filter(({ kind }) => kind === "obstacle"))
    found.set(row.index, [...(found.get(row.index) ?? []), row]);
  return [...found.values()];
}

/** Largest gain among a recording's neighbour rows: the rim of the panel. */
function largestGain(rec) {
  if (rec.rim) return rec.rim;
  const [, , rows, dim] = rec.shape.observations;
  const slots = DATA.scenarios[rec.scenario].neighbour_slots;
  rec.rim = 1e-9;
  for (let at = 0; at < rec.observations.length; at += dim) {
    if ((at / dim) % rows >= slots) continue;
    rec.rim = Math.max(rec.rim, Math.hypot(...rec.observations.subarray(at, at + dim)));
  }
  return rec.rim;
}

/** Draw one projection of a robot's observation, with its x axis to the right. */
function drawSight(canvas, rec, frame, robot, axes) {
  const [pen, width, height] = prepare(canvas);
  const [cx, cy] = [0.5 * width, 0.5 * height];
  const radius = 0.5 * Math.min(width, height) - 20;
  drawRim(pen, cx, cy, radius, axes);
  if (robot === null || !isActive(rec, frame, robot)) {
    pen.fillStyle = colour("muted");
    pen.textAlign = "center";
    pen.fillText(robot === null ? "choose a robot" : "merged away", cx, cy + 4);
    return;
  }
  const rows = rowsOf(rec, frame, robot);
  const at = (vector, length) => [
    cx + length * radius * vector[axes[0]], cy - length * radius * vector[axes[1]],
  ];
  for (const points of silhouettes(rows)) drawSilhouette(pen, points, at, cx, cy, radius);
  if (!DATA.scenarios[rec.scenario].exact)
    for (const { direction } of trueDirections(rec, frame, robot))
      drawTruth(pen, at(direction, 1), cx, cy);
  drawNet(pen, rows, at, cx, cy);
  const gain = largestGain(rec);
  const labels = [];
  for (const { kind, index, vector } of rows)
    if (kind === "neighbour") drawBearing(pen, vector, index, at(vector, 1 / gain), cx, cy, labels);
    else if (kind === "own") drawOwn(pen, at(vector, 0.9 / Math.max(1, Math.hypot(...vector))), cx, cy, rec);
  pen.fillStyle = robotColour(robot);
  pen.beginPath();
  pen.arc(cx, cy, 5, 0, 2 * Math.PI);
  pen.fill();
}

function drawRim(pen, cx, cy, radius, axes) {
  pen.font = "11px system-ui, sans-serif";
  pen.strokeStyle = colour("line");
  pen.fillStyle = colour("muted");
  pen.lineWidth = 1;
  for (const share of [0.5, 1]) ring(pen, cx, cy, share * radius, colour("line"), 1);
  line(pen, cx - radius, cy, cx + radius, cy);
  line(pen, cx, cy - radius, cx, cy + radius);
  pen.textAlign = "center";
  pen.fillText("xyz"[axes[0]], cx + radius - 8, cy - 4);
  pen.fillText("xyz"[axes[1]], cx + 8, cy - radius + 12);
}

/** A thin grey ray: where another robot is, whatever the sensor says. */
function drawTruth(pen, [x, y], cx, cy) {
  pen.strokeStyle = colour("muted");
  pen.lineWidth = 1;
  line(pen, cx, cy, x, y);
}

/** In the plane the angle between both edges; in 3-D the outline of the boundary rays. */
function drawSilhouette(pen, points, at, cx, cy, radius) {
  const ends = points.map(({ vector }) => at(vector, 1));
  pen.fillStyle = pen.strokeStyle = colour("obstacle");
  pen.lineWidth = 2;
  pen.beginPath();
  if (points[0].vector.length === 2 && points.length === 2) {
    const [first, last] = ends.map(([x, y]) => Math.atan2(y - cy, x - cx));
    pen.moveTo(cx, cy);
    pen.arc(cx, cy, radius, last, first, true); // from the clockwise to the other edge
  } else for (const [x, y] of ends) pen.lineTo(x, y);
  pen.closePath();
  pen.globalAlpha = 0.3;
  pen.fill();
  pen.globalAlpha = 1;
  if (points[0].vector.length === 3) pen.stroke();
  else for (const [x, y] of ends) line(pen, cx, cy, x, y);
}

function drawBearing(pen, vector, index, [x, y], cx, cy, labels) {
  pen.strokeStyle = pen.fillStyle = index === null ? colour("accent") : robotColour(index);
  pen.lineWidth = 2;
  arrow(pen, cx, cy, x - cx, y - cy);
  const length = Math.hypot(x - cx, y - cy);
  if (length < 12 || index === null) return;
  pen.fillStyle = colour("ink");
  pen.textAlign = "center";
  const out = (pixels) => [x, y].map((end, k) => end + (pixels * (end - [cx, cy][k])) / length);
  const isFree = ([left, top]) => labels.every(([a, b]) => Math.hypot(left - a, top - b) > 12);
  const spot = [11, -14, -27, -40].map(out).find(isFree) ?? out(11);
  labels.push(spot);
  pen.fillText(index, spot[0], spot[1] + 4);
}

/** f, the sum of the neighbours' rows, as a share of the sum of their lengths. */
function drawNet(pen, rows, at, cx, cy) {
  const seen = rows.filter(({ kind }) => kind === "neighbour").map(({ vector }) => vector);
  if (seen.length < 2) return;
  const total = seen.reduce((sum, vector) => sum + Math.hypot(...vector), 0);
  const net = seen[0].map((_, k) => seen.reduce((sum, vector) => sum + vector[k], 0));
  const [x, y] = at(net, 1 / total);
  pen.strokeStyle = pen.fillStyle = colour("muted");
  pen.globalAlpha = 0.55;
  pen.lineWidth = 6;
  arrow(pen, cx, cy, x - cx, y - cy, 13);
  pen.globalAlpha = 1;
  pen.textAlign = "center";
  if (Math.hypot(x - cx, y - cy) > 20)
    pen.fillText("f", cx + 0.55 * (x - cx) + 9, cy + 0.55 * (y - cy) - 5);
}

/** What a robot senses of itself: gravity, or its own velocity. */
function drawOwn(pen, [x, y], cx, cy, rec) {
  pen.strokeStyle = pen.fillStyle = colour("muted");
  pen.lineWidth = 1.5;
  pen.setLineDash([4, 3]);
  arrow(pen, cx, cy, x - cx, y - cy);
  pen.setLineDash([]);
  pen.textAlign = "center";
  if (Math.hypot(x - cx, y - cy) > 12)
    pen.fillText(DATA.scenarios[rec.scenario].own_row, x, y + (y > cy ? 12 : -6));
}

/** The same rows as a table of numbers; where the sensor errs, beside what is true. */
function listRows(box, rec, frame, robot) {
  const lives = robot !== null && isActive(rec, frame, robot);
  const rows = lives ? rowsOf(rec, frame, robot) : [];
  const errs = lives && !DATA.scenarios[rec.scenario].exact;
  const name = ({ kind, index, point }) =>
    kind === "neighbour" ? (index === null ? "a neighbour" : `robot ${index}`) :
    kind === "own" ? DATA.scenarios[rec.scenario].own_row :
    `obstacle ${index}, ${rec.shape.positions[2] === 2 ? ["left", "right"][point] : `ray ${point}`}`;
  const lines = rows.map((row) => numbers(name(row), row.vector));
  if (errs) lines.push(...trueLines(rec, frame, robot, rows));
  box.replaceChildren(make("table", {}, make("tbody", {}, ...lines)));
}

function numbers(name, vector, ...more) {
  const cells = [...vector.map((part) => part.toFixed(3).replace("-", "−")), ...more];
  return make("tr", {}, make("td", { className: "word", textContent: name }),
    ...cells.map((textContent) => make("td", { textContent })));
}

/** The true direction of every other robot, and how far off it is seen. */
function trueLines(rec, frame, robot, rows) {
  return trueDirections(rec, frame, robot).map(({ index, direction }) => {
    const seen = rows.find((row) => row.kind === "neighbour" && row.index === index);
    const line = numbers(`truly ${index}`, direction, seen ? `${offBy(seen.vector, direction)}°` : "unseen");
    line.className = "true";
    return line;
  });
}

/** Angle between two directions, whole degrees. */
function offBy(seen, direction) {
  const along = seen.reduce((sum, x, k) => sum + x * direction[k], 0) / Math.hypot(...seen);
  return Math.round((Math.acos(Math.min(1, Math.max(-1, along))) * 180) / Math.PI);
}
