// Tables of results.csv and paired.csv, and who is best.

function seconds(cell, row) {
  const limit = DATA.scenarios[row.scenario].limit;
  return Number(cell) >= limit - 1e-9 ? `> ${short(String(limit))}` : fixed(cell, 2);
}

const CLEAN = { title: "collision-free %", value: "collision_free_success", range: ["collision_free_low", "collision_free_high"],
  show: percent, bar: true, best: 1, key: true };
const TIME = { title: "median time s", value: "median_time", range: ["time_low", "time_high"],
  show: seconds, best: -1, key: true };
const SCENARIO = { title: "scenario", value: "scenario", word: true };
const POLICY = { title: "policy", value: "policy", word: true, link: replayLink, key: true,
  names: true };

const RESULT_COLUMNS = [
  SCENARIO,
  POLICY,
  { title: "initial conditions", value: "episodes", show: (cell) => cell, best: 1 },
  { title: "met %", value: "success", range: ["success_low", "success_high"], show: percent,
    best: 1 },
  CLEAN,
  TIME,
  { title: "time/bound", value: "time_over_bound", show: short, best: -1 },
  { title: "path m", value: "path_length", show: (cell) => metres(cell, 1), best: -1 },
  { title: "contacts", value: "contacts", show: (cell) => fixed(cell, 1), best: -1 },
  { title: "clearance m", value: "min_clearance", show: clearance, best: 1 },
  { title: "V rise m²/s", value: "max_rise_between_merges", best: -1, show: (cell, row) =>
    (Number(cell) <= DATA.scenarios[row.scenario].rounding ? "none" : short(cell)) },
  { title: "alignment", value: "min_alignment", show: (cell) => fixed(cell, 2), best: 1 },
];

const PAIRED_COLUMNS = [
  SCENARIO,
  POLICY,
  { title: "against", value: "against", word: true },
  { title: "difference, collision-free %", value: "collision_free_difference", best: 1, key: true,
    range: ["collision_free_difference_low", "collision_free_difference_high"], show: percent },
  { title: "better on a start, %", value: "probability_of_improvement", best: 1, key: true,
    range: ["improvement_low", "improvement_high"], show: percent, bar: true },
];

const BEST_COLUMNS = [
  SCENARIO,
  { ...POLICY, title: "best" },
  CLEAN,
  TIME,
  { title: "tied with it", value: "tied", word: true, wraps: true },
];

/** A policy's name that leads to its replay, if a start of it was kept. */
function replayLink({ scenario, policy }) {
  if (!kept((one) => one.scenario === scenario && one.policy === policy).length) return null;
  const link = make("a", {
    href: fragmentOf({ scenario, policies: [policy] }), textContent: policy,
    title: `Replay ${policy} on ${scenario}`,
  });
  link.addEventListener("click", () => find("replay").scrollIntoView());
  return link;
}

function showTables() {
  const table = (name, columns, rows) => sortableTable(find(`${name}-table`), columns, rows);
  const tables = {
    results: table("results", RESULT_COLUMNS, DATA.results),
    paired: table("paired", PAIRED_COLUMNS, DATA.paired),
  };
  table("best", BEST_COLUMNS, bestRows());
  controls(tables, Object.keys(DATA.scenarios));
}

/** The row of the best policy of each scenario, with those that are tied with it. */
function bestRows() {
  return DATA.rankings.filter(({ top }) => top.length).map(({ scenario, top: [best, ...tied] }) => ({
    ...DATA.results.find((row) => row.scenario === scenario && row.policy === best),
    tied: tied.join(", "),
  }));
}

showTables();
