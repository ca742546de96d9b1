// Tables of leaderboard.csv and of its cells.

const PERCENT = (cell) => fixed(cell, 1, 100);
const CLEAN = { title: "collision-free %", show: PERCENT, bar: true, best: 1, key: true,
  value: "clean", range: ["clean_low", "clean_high"] };
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
  CLEAN,
  TIME,
  ...COUNTS,
  { title: "rise, % of V₀", value: "rise", show: short, best: -1 },
  { title: "runs", value: "runs", show: (cell) => cell, best: 1 },
  { title: "robot steps", value: "robot_steps", show: (cell) => cell, best: 1 },
];

const CELL_COLUMNS = [
  { title: "algorithm", value: "algorithm", word: true, key: true, link: cardLink },
  { title: "field", value: "scenario", word: true },
  { title: "seed", value: "seed", show: (cell) => cell, best: -1, key: true },
  { ...CLEAN, range: null, bar: false },
  { ...TIME, range: null },
  ...COUNTS,
];

/** An algorithm's name that leads to the card of its run. */
function cardLink({ algorithm, card }) {
  return make("a", { href: card, textContent: algorithm, title: card });
}

const table = (name, columns, rows) => sortableTable(find(`${name}-table`), columns, rows);
table("board", BOARD_COLUMNS, DATA.board);
controls(
  { board: { show: () => {}, rows: () => DATA.board }, cells: table("cells", CELL_COLUMNS, DATA.cells) },
  new Set(DATA.cells.map(({ scenario }) => scenario)),
);
