// One policy of the replay: world, observation of a robot, plots and outcome.

class Pane {
  constructor(side) {
    this.root = find("pane").content.firstElementChild.cloneNode(true);
    this.root.setAttribute("aria-label", `${side} policy`);
    this.part = (name) => this.root.querySelector(name);
    this.choice = this.part(".policy");
    this.choice.addEventListener("change", () => choosePolicy(this));
    this.part("details").addEventListener("toggle", () => this.rec && this.draw());
    this.part(".png").addEventListener("click", () => this.save());
  }

  /** Canvases for one projection in the plane, two in 3-D. */
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
    this.eyes = canvases(".eye", "Observation of the selected robot");
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

  /** On a narrow screen one of both sides has no size. */
  get isShown() {
    return this.root.offsetWidth > 0;
  }

  plots(other) {
    if (!this.isShown) return;
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
    if (!this.isShown) return;
    this.worlds.forEach((canvas, k) =>
      drawWorld(canvas, rec, moment, state.bounds, this.axes, k, state.chosen));
    this.eyes.forEach((canvas, k) =>
      drawSight(canvas, rec, moment.frame, state.chosen, this.axes[k]));
    if (this.part("details").open)
      listRows(this.part(".rows"), rec, moment.frame, state.chosen);
    this.lines?.forEach((move) => move(state.time));
    this.say(rec, moment.frame);
  }

  say(rec, frame) {
    const robots = rec.shape.active[1];
    const sum = (array) => array.subarray(frame * robots, (frame + 1) * robots)
      .reduce((a, b) => a + b, 0);
    const [left, contacts] = [sum(rec.active), sum(rec.contacts)];
    const over = frame === rec.times.length - 1;
    const end = rec.outcome.success === "1" ? "met" : "time out";
    this.part(".state").textContent =
      `${over ? `${end} at ${rec.times[frame].toFixed(2)} s · ` : ""}${left} of ${robots} robots left` +
      (contacts ? ` · ${inContact(contacts)}` : "") + this.failures(frame);
    const value = rec.lyapunov[frame];
    this.part(".v-now").textContent = value < 100 ? value.toPrecision(3) : value.toFixed(0);
    const chosen = rec.alignment[frame * robots + (state.chosen ?? 0)];
    this.part(".a-now").textContent =
      state.chosen === null || Number.isNaN(chosen) ? "" :
      `robot ${state.chosen}: ${chosen.toFixed(3)}`;
  }

  /** Numbers of the robots that have failed or are inactive, as text. */
  failures(frame) {
    const robots = [...Array(this.rec.shape.active[1]).keys()]
      .filter((robot) => isActive(this.rec, frame, robot));
    return Object.keys(CONDITIONS).map((condition) => {
      const count = robots.filter((robot) => isIn(condition, this.rec, frame, robot)).length;
      return count ? ` · ${count} ${condition}` : "";
    }).join("");
  }

  save() {
    const { scenario, start, policy } = this.rec;
    const time = `${state.time.toFixed(2)} s`;
    savePicture(`${scenario}-${start}-${policy}-${time}.png`,
      `${scenario}, initial condition ${start}: ${policy}, ${time}; right: observation of robot ${state.chosen}`,
      [...this.worlds, ...this.eyes]);
  }

  showOutcome() {
    const row = this.rec.outcome;
    this.part(".outcome").textContent =
      `${row.success === "1" ? "met" : "not met"} after ${fixed(row.time, 2)} s · ` +
      inContact(row.contacts) +
      (row.path_length ? ` · path ${metres(row.path_length, 1)} m` : "") +
      (row.clearance ? ` · clearance ≥ ${clearance(row.clearance, this.rec)} m` : "") +
      (row.min_alignment ? ` · alignment ≥ ${fixed(row.min_alignment, 2)}` : "") +
      (this.rec.stride > 1 ? ` · one in ${this.rec.stride} recorded frames is shown` : "");
  }
}

function largest(rec) {
  return rec.lyapunov.reduce((a, b) => Math.max(a, b), 0);
}

/** "1 robot-step in contact": contacts are counted once for each robot and step. */
function inContact(number) {
  return `${number} robot-step${Number(number) === 1 ? "" : "s"} in contact`;
}

/** How an episode ended, as a sentence about its policy. */
function ending({ policy, scenario, outcome }) {
  const touched = Number(outcome.contacts);
  const met = outcome.success === "1";
  const how = met ? `meets after ${fixed(outcome.time, 2)} s` : `does not meet in ${fixed(outcome.time, 1)} s`;
  const hasObstacles = DATA.scenarios[scenario].obstacle_slots > 0;
  const contacts = touched ? ` with ${inContact(touched)}` : hasObstacles ? " without a contact" : "";
  return `${policy} ${how}${contacts}`;
}
