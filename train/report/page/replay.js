// Two policies on the same start: choices, time, drawing, keyboard.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const state = {
  time: 0, end: 1, bounds: null, playing: false, speed: 1, chosen: 0, loading: 0, side: 1,
};
const panes = [];
// ---- choosing -----------------------------------------------------------------------------------

function fill(select, values, labels = values) {
  const before = select.value;
  select.replaceChildren(...values.map((value, k) =>
    make("option", { value, textContent: labels[k] })));
  if (values.map(String).includes(before)) select.value = before;
}

/** Show a start under two policies, or one; from its beginning unless a time is said. */
function show({ scenario, start, policies, robot = 0, time, side = state.side }) {
  find("scenario").value = scenario;
  const own = kept((one) => one.scenario === scenario);
  const starts = unique(own.map((one) => one.start));
  const { seed } = DATA.run; // none of a single rollout
  const named = (k) => (seed === undefined ? k : `${k} (seed ${BigInt(seed) + BigInt(k)})`);
  fill(find("start"), starts, starts.map(named));
  find("start").value = start;
  // of a start that is kept because a policy failed there are no others
  const names = unique(own.filter((one) => one.start === Number(start)).map(({ policy }) => policy));
  policies = policies.filter((policy) => names.includes(policy));
  policies = policies.length ? policies : names.slice(0, 2);
  panes.forEach((pane, k) => {
    fill(pane.choice, names);
    pane.choice.value = policies[k] ?? policies[0];
  });
  Object.assign(state, { chosen: robot, side });
  return load(time);
}

/** A policy chosen on one side; the other side takes the one that stood here if they were alike. */
function choosePolicy(pane) {
  const other = panes[1 - panes.indexOf(pane)];
  if (other.choice.value === pane.choice.value) other.choice.value = pane.rec.policy;
  load();
}

/** Take up both recordings that are chosen, from the beginning unless a time is said. */
async function load(time) {
  const turn = ++state.loading;
  pause();
  const numbers = panes.map(({ choice }) => DATA.recordings.findIndex((entry) =>
    entry.scenario === find("scenario").value && entry.policy === choice.value &&
    entry.start === Number(find("start").value)));
  const found = await Promise.all(numbers.map(recording));
  if (turn !== state.loading) return; // another choice was made meanwhile
  found.forEach((rec, k) => {
    panes[k].rec = rec;
    panes[k].lay(rec.shape.positions[2], rec.policy);
    panes[k].showOutcome();
  });
  const alone = found[0] === found[1];
  document.querySelector(".panes").classList.toggle("alone", alone);
  state.bounds = boundsOf(found);
  state.end = Math.max(...found.map(({ times }) => times.at(-1)));
  state.frames = unique(found.flatMap(({ times }) => Array.from(times))).sort((a, b) => a - b);
  find("time").max = state.end;
  robotButtons(found[0].shape.positions[1]);
  switchButtons(alone ? [] : found);
  find("said").textContent = sentence(alone ? found.slice(0, 1) : found);
  redraw();
  seek(time ?? 0);
  writeAddress();
  find("player").dataset.ready = numbers.join(" ");
}

/** What can be seen here, in words. */
function sentence(found) {
  const [{ scenario, start, outcome }] = found;
  const single = DATA.results.find((row) => row.scenario === scenario).episodes === "1";
  const where = single ? scenario : `${scenario}, initial condition ${start}`;
  return outcome && `${where}: ${found.map(ending).join("; ")}.`;
}

/** On a narrow screen one policy is shown at a time. */
function switchButtons(found) {
  const buttons = found.map(({ policy }, side) => {
    const button = make("button", { type: "button", textContent: policy });
    button.addEventListener("click", () => turnTo(side));
    return button;
  });
  find("switch").replaceChildren(...buttons);
  turnTo(found.length ? state.side : 0);
}

function turnTo(side) {
  state.side = side;
  panes.forEach(({ root }, k) => root.classList.toggle("behind", k !== side));
  find("switch").childNodes.forEach((button, k) => button.setAttribute("aria-pressed", k === side));
  redraw();
}

/** Let the address say what is shown, so that it can be shared. */
function writeAddress() {
  const { scenario, start, policy } = panes[0].rec;
  const policies = unique([policy, panes[1].rec.policy]);
  history.replaceState(null, "", fragmentOf({
    scenario, start, policies, robot: state.chosen, time: state.time,
  }));
}

async function copyLink() {
  writeAddress();
  const button = find("copy");
  try {
    await navigator.clipboard.writeText(location.href);
    button.textContent = "Copied";
  } catch {
    button.textContent = "It is in the address bar";
  }
  setTimeout(() => (button.textContent = "Copy link"), 2000);
}

function robotButtons(robots) {
  if (state.chosen >= robots) state.chosen = 0;
  const buttons = Array.from({ length: robots }, (_, robot) => {
    const button = make("button", { type: "button", textContent: robot });
    button.setAttribute("aria-label", `Robot ${robot}`);
    button.addEventListener("click", () => choose(robot));
    return button;
  });
  find("robots").replaceChildren(...buttons);
}

function choose(robot) {
  state.chosen = robot;
  redraw();
  writeAddress();
}

// ---- time ---------------------------------------------------------------------------------------

function seek(time) {
  state.time = Math.min(state.end, Math.max(0, time));
  const slider = find("time");
  slider.value = state.time;
  slider.setAttribute("aria-valuetext", `${state.time.toFixed(2)} s`);
  find("clock").textContent = `${state.time.toFixed(2)} s`;
  panes.forEach((pane) => pane.draw());
}

/** To the next recorded frame of either policy, or the one before. */
function stepFrame(direction) {
  const { frames, time } = state;
  const next = direction > 0
    ? frames.find((frame) => frame > time + 1e-6)
    : frames.findLast((frame) => frame < time - 1e-6);
  jump(next ?? (direction > 0 ? state.end : 0));
}

function play() {
  if (state.time >= state.end) seek(0);
  state.playing = true;
  showPlaying();
  let last = performance.now();
  const advance = (now) => {
    if (!state.playing) return;
    seek(state.time + (Math.max(0, now - last) / 1000) * state.speed);
    last = now;
    if (state.time >= state.end) pause();
    else requestAnimationFrame(advance);
  };
  requestAnimationFrame(advance);
}

function pause() {
  if (state.playing) writeAddress();
  state.playing = false;
  showPlaying();
}

function showPlaying() {
  const word = state.playing ? "Pause" : "Play";
  find("play").textContent = word;
  find("play").setAttribute("aria-label", word);
}

const toggle = () => (state.playing ? pause() : play());

function jump(time) {
  pause();
  seek(time);
  clearTimeout(state.writing); // browsers allow few changes of the address in a second
  state.writing = setTimeout(writeAddress, 250);
}

function changeSpeed(by) {
  const place = SPEEDS.indexOf(state.speed) + by;
  state.speed = SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, place))];
  find("speed").value = state.speed;
}

// ---- drawing anew -------------------------------------------------------------------------------

/** Everything that depends on size, theme or chosen robot. */
function redraw() {
  if (!panes.every(({ rec }) => rec)) return;
  find("robots").childNodes.forEach((button, robot) => {
    button.style.borderBottomColor = robotColour(robot);
    button.setAttribute("aria-pressed", robot === state.chosen);
  });
  panes.forEach((pane, k) => {
    pane.part(".sight h3").textContent = `Observation of robot ${state.chosen}`;
    pane.plots(panes[1 - k]);
    pane.draw();
  });
}

// ---- start --------------------------------------------------------------------------------------

const KEYS = {
  " ": toggle,
  ArrowLeft: () => stepFrame(-1),
  ArrowRight: () => stepFrame(1),
  Home: () => jump(0),
  End: () => jump(state.end),
  "[": () => changeSpeed(-1),
  "]": () => changeSpeed(1),
};

/** Keys of the replay, unless they mean something where the focus is. */
function press(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in KEYS)) return;
  if (event.target.closest("select, textarea")) return;
  if (event.key === " " && event.target.closest("button, summary, a")) return;
  event.preventDefault();
  KEYS[event.key]();
}

function startReplay() {
  for (const side of ["Left", "Right"]) panes.push(new Pane(side));
  document.querySelector(".panes").append(...panes.map(({ root }) => root));
  fill(find("scenario"), unique(DATA.recordings.map(({ scenario }) => scenario)));
  fill(find("speed"), SPEEDS, SPEEDS.map((speed) => `${speed}×`));
  find("speed").value = state.speed;
  find("scenario").addEventListener("change", () => show(opening(find("scenario").value)));
  find("start").addEventListener("change", () => show({
    scenario: find("scenario").value, start: Number(find("start").value),
    policies: panes.map(({ choice }) => choice.value), robot: state.chosen,
  }));
  find("copy").addEventListener("click", copyLink);
  find("speed").addEventListener("change", () => (state.speed = Number(find("speed").value)));
  find("play").addEventListener("click", toggle);
  find("to-start").addEventListener("click", KEYS.Home);
  find("to-end").addEventListener("click", KEYS.End);
  find("back").addEventListener("click", KEYS.ArrowLeft);
  find("forward").addEventListener("click", KEYS.ArrowRight);
  find("time").addEventListener("input", () => jump(Number(find("time").value)));
  document.addEventListener("keydown", press);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  new ResizeObserver(redraw).observe(document.querySelector(".panes"));
  addEventListener("hashchange", () => {
    const found = asked();
    if (found) begin(found);
  });
  begin(asked());
}

/** What the address asks for, or a start on which policies differ; playing if it can be seen. */
async function begin(found) {
  await show(found ?? opening());
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const inSight = found || find("player").getBoundingClientRect().top < innerHeight;
  if (!still && inSight && found?.time === undefined) play();
}

if (DATA.recordings.length) startReplay();
