// Two policies on the same start: choices, time, drawing, keyboard.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const state = {
  scenario: "", start: 0, time: 0, end: 1, bounds: null, playing: false, speed: 1, chosen: 0,
  loading: 0,
};
const panes = [];
const find = (id) => document.getElementById(id);

// ---- panes --------------------------------------------------------------------------------------

class Pane {
  constructor(side) {
    this.root = find("pane").content.firstElementChild.cloneNode(true);
    this.root.setAttribute("aria-label", `${side} policy`);
    this.part = (name) => this.root.querySelector(name);
    this.choice = this.part(".policy");
    this.choice.addEventListener("change", load);
    this.part("details").addEventListener("toggle", () => this.rec && this.draw());
  }

  /** Canvases for one projection in the plane, two in space. */
  lay(dim, policy) {
    this.root.classList.toggle("space", dim === 3);
    this.axes = dim === 2 ? [[0, 1]] : [[0, 1], [0, 2]];
    const canvases = (box, what) => {
      const made = this.axes.map(([a, b]) => {
        const canvas = make("canvas");
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${what}, ${policy}, ${"xyz"[a]}–${"xyz"[b]} plane`);
        return canvas;
      });
      this.part(box).replaceChildren(...made);
      return made;
    };
    this.worlds = canvases(".world", "World");
    this.eyes = canvases(".eye", "What the chosen robot sees");
    for (const canvas of this.worlds)
      canvas.addEventListener("click", (event) => {
        const near = robotNear(canvas, this.rec, this.moment, event.offsetX, event.offsetY);
        if (near !== null) choose(near);
      });
  }

  /** The frame at the time of the replay, and how far on to the next one. */
  get moment() {
    const { times } = this.rec;
    const frame = frameAt(times, state.time);
    const next = Math.min(frame + 1, times.length - 1);
    const share = next > frame ? (state.time - times[frame]) / (times[next] - times[frame]) : 0;
    return { frame, share: Math.min(1, Math.max(0, share)), time: state.time };
  }

  plots(other) {
    const top = Math.max(...panes.map(({ rec }) => largest(rec)));
    const differs = other.rec !== this.rec;
    this.lines = [
      lyapunovPlot(this.part(".v"), this.rec, differs && other.rec, top, state.end, seek),
      alignmentPlot(this.part(".a"), this.rec, state.chosen, state.end, seek),
    ];
    this.part(".other").textContent = differs ? `dashed: ${other.rec.policy}` : "";
  }

  draw() {
    const { rec, moment } = this;
    this.worlds.forEach((canvas, k) =>
      drawWorld(canvas, rec, moment, state.bounds, this.axes, k, state.chosen));
    this.eyes.forEach((canvas, k) =>
      drawSight(canvas, rec, moment.frame, state.chosen, this.axes[k]));
    if (this.part("details").open)
      listRows(this.part(".rows"), rec, moment.frame, state.chosen);
    this.lines.forEach((move) => move(state.time));
    this.say(rec, moment.frame);
  }

  say(rec, frame) {
    const robots = rec.shape.active[1];
    const sum = (array) => array.subarray(frame * robots, (frame + 1) * robots)
      .reduce((a, b) => a + b, 0);
    const [left, contacts] = [sum(rec.active), sum(rec.contacts)];
    const over = frame === rec.times.length - 1;
    const end = left === 1 ? "met" : "time out";
    this.part(".state").textContent =
      `${over ? `${end} at ${rec.times[frame].toFixed(2)} s · ` : ""}${left} of ${robots} robots left` +
      (contacts ? ` · ${contacts} contacts` : "");
    const value = rec.lyapunov[frame];
    this.part(".v-now").textContent = value < 100 ? value.toPrecision(3) : value.toFixed(0);
    const chosen = rec.alignment[frame * robots + (state.chosen ?? 0)];
    this.part(".a-now").textContent =
      state.chosen === null || Number.isNaN(chosen) ? "" :
      `robot ${state.chosen}: ${chosen.toFixed(3)}`;
  }

  showOutcome() {
    const row = this.rec.outcome;
    this.part(".outcome").textContent =
      `${row.success === "1" ? "met" : "not met"} after ${fixed(row.time, 2)} s · ` +
      `${row.contacts} contacts · path ${fixed(row.path_length, 1)} m` +
      (row.clearance ? ` · clearance ≥ ${fixed(row.clearance, 2)} m` : "") +
      (row.min_alignment ? ` · alignment ≥ ${fixed(row.min_alignment, 2)}` : "") +
      (this.rec.stride > 1 ? ` · one in ${this.rec.stride} recorded frames is shown` : "");
  }
}

function largest(rec) {
  return rec.lyapunov.reduce((a, b) => Math.max(a, b), 0);
}

// ---- choosing -----------------------------------------------------------------------------------

function fill(select, values, labels = values) {
  const before = select.value;
  select.replaceChildren(...values.map((value, k) =>
    make("option", { value, textContent: labels[k] })));
  if (values.map(String).includes(before)) select.value = before;
}

const kept = (test) => DATA.recordings.filter(test);
const unique = (values) => [...new Set(values)];

/** What a scenario has, after it was chosen. */
function chooseScenario() {
  const own = kept(({ scenario }) => scenario === find("scenario").value);
  const starts = unique(own.map(({ start }) => start));
  fill(find("start"), starts, starts.map((start) => `${start} (seed ${DATA.run.seed + start})`));
  const policies = unique(own.map(({ policy }) => policy));
  panes.forEach(({ choice }) => fill(choice, policies));
  const rivals = policies.slice(1);
  if (rivals.length) {
    const score = (policy) => Number(DATA.results.find((row) =>
      row.scenario === own[0].scenario && row.policy === policy).clean_success);
    panes[0].choice.value = policies[0];
    panes[1].choice.value = rivals.reduce((a, b) => (score(b) > score(a) ? b : a));
  }
  state.chosen = 0;
  return load();
}

/** Take up both recordings that are chosen, from time 0. */
async function load() {
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
  state.bounds = boundsOf(found);
  state.end = Math.max(...found.map(({ times }) => times.at(-1)));
  state.frames = unique(found.flatMap(({ times }) => Array.from(times))).sort((a, b) => a - b);
  find("time").max = state.end;
  robotButtons(found[0].shape.positions[1]);
  redraw();
  seek(0);
  find("player").dataset.ready = numbers.join(" ");
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
  pause();
  const { frames, time } = state;
  const next = direction > 0
    ? frames.find((frame) => frame > time + 1e-6)
    : frames.findLast((frame) => frame < time - 1e-6);
  seek(next ?? (direction > 0 ? state.end : 0));
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
    pane.part(".sight h3").textContent = `What robot ${state.chosen} sees`;
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
  const names = unique(DATA.recordings.map(({ scenario }) => scenario));
  fill(find("scenario"), names);
  find("scenario").value = names.find((name) => DATA.scenarios[name].obstacle_slots) ?? names[0];
  fill(find("speed"), SPEEDS, SPEEDS.map((speed) => `${speed}×`));
  find("speed").value = state.speed;
  find("scenario").addEventListener("change", chooseScenario);
  find("start").addEventListener("change", load);
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
  chooseScenario();
}

if (DATA.recordings.length) startReplay();
