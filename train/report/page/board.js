// Tables of leaderboard.csv and of its cells, which lead to replays.

const PERCENT = (cell) => fixed(cell, 1, 100);
const COLLISION_FREE = { title: "collision-free %", show: PERCENT, bar: true, best: 1, key: true,
  value: "collision_free", range: ["collision_free_low", "collision_free_high"] };
const TIME = { title: "time s", show: (cell) => fixed(cell, 1), best: -1, key: true,
  value: "time", range: ["time_low", "time_high"] };
const COUNTS = [
  { title: "touches ‰", value: "touches", show: short, best: -1 },
  { title: "V rose ‰", value: "risen", show: short, best: -1 },
];

const BOARD_COLUMNS = [
  { title: "algorithm", value: "algorithm", word: true, key: true },
  { title: "safety", value: "safety", word: true },
  { title: "guarantee", value: "guarantee", word: true },
  { title: "reads", value: "given", word: true },
  COLLISION_FREE,
  TIME,
  ...COUNTS,
  { title: "rise, % of V₀", value: "rise", show: short, best: -1 },
  { title: "runs", value: "runs", show: (cell) => cell, best: 1 },
  { title: "robot steps", value: "robot_steps", show: (cell) => cell, best: 1 },
];

const CELL_COLUMNS = [
  { title: "algorithm", value: "algorithm", word: true, key: true, link: cardLink,
    names: true },
  { title: "field", value: "scenario", word: true },
  { title: "seed", value: "seed", show: (cell) => cell, best: -1, key: true },
  { ...COLLISION_FREE, range: null, bar: false },
  { ...TIME, range: null },
  ...COUNTS,
  { title: "replay", value: "replay", word: true, key: true,
    link: (run) => replayLink(run, run.replay ? "replay" : "–") },
];

const FIELDS = Object.keys(DATA.scenarios);
const FIELD_COLUMNS = [
  { title: "algorithm", value: "algorithm", word: true, key: true },
  ...FIELDS.map((field) => ({
    title: field.replace(/^.*\//, "").replace(/-v\d+$/, ""), value: field, best: 1, key: true,
    link: (row) => fieldLink(row, field),
  })),
];

/** An algorithm's name that leads to the card of its run. */
function cardLink({ algorithm, card }) {
  return make("a", { href: card, textContent: algorithm, title: card });
}

const runsOf = (algorithm, field) =>
  DATA.cells.filter((run) => run.algorithm === algorithm && run.scenario === field);

/** Collision-free success of an algorithm on each field, mean over runs. */
function fieldRow({ algorithm }) {
  const mean = (runs) =>
    runs.reduce((sum, run) => sum + Number(run.collision_free), 0) / runs.length;
  const cells = FIELDS.map((field) => [field, runsOf(algorithm, field)]);
  return { algorithm, ...Object.fromEntries(
    cells.map(([field, runs]) => [field, runs.length ? String(mean(runs)) : ""])) };
}

/** It leads to the replay of the first run that has one. */
function fieldLink(row, field) {
  const runs = runsOf(row.algorithm, field);
  if (!runs.length) return "–";
  return replayLink(runs.find((run) => run.replay) ?? runs[0], PERCENT(row[field]));
}

/** What leads to a run's replay; without one, to what makes it. */
function replayLink(run, textContent) {
  const where = `${run.algorithm} on ${run.scenario}`;
  const href = run.replay ? fragmentOf({ scenario: run.scenario, policies: [run.replay] }) : "#replay";
  const title = run.replay ? `Replay ${where}` : `No replay of ${where} was kept`;
  const link = make("a", { href, textContent, title, className: run.replay ? "" : "missing" });
  link.addEventListener("click", () => {
    find("missing").hidden = Boolean(run.replay);
    if (!run.replay) sayHowToRecord(run);
    find("replay").scrollIntoView();
  });
  return link;
}

function sayHowToRecord({ algorithm, scenario, seed, card, seconds }) {
  const command = `rendezvous leaderboard --repeat ${DATA.folder}/${card} --record`;
  find("missing").replaceChildren(
    `No replay of ${algorithm} on ${scenario}, seed ${seed}, was kept. It is made by `,
    make("code", { textContent: command }),
    ` (some ${fixed(seconds, 0)} s), and this page then anew by `,
    make("code", { textContent: `rendezvous report ${DATA.folder}` }), ".",
  );
}

const table = (name, columns, rows) => sortableTable(find(`${name}-table`), columns, rows);
table("board", BOARD_COLUMNS, DATA.board);
const rows = DATA.board.map(fieldRow);
table("fields", FIELD_COLUMNS, rows);
controls(
  {
    board: { show: () => {}, rows: () => DATA.board },
    fields: { show: () => {}, rows: () => rows },
    cells: table("cells", CELL_COLUMNS, DATA.cells),
  },
  FIELDS,
);
