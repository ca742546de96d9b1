// Sortable tables of results.csv and paired.csv; every cell carries the text of the file.

const MINUS = (text) => text.replace("-", "−");

/** A number to so many digits after the point, without a sign on a rounded zero. */
function fixed(cell, digits, factor = 1) {
  if (cell === "") return "–";
  const text = (factor * Number(cell)).toFixed(digits);
  return MINUS(Number(text) === 0 ? text.replace("-", "") : text);
}

function short(cell) {
  return cell === "" ? "–" : MINUS(String(Number(Number(cell).toPrecision(2))));
}

/** Percent with one digit where there are enough starts to mean it. */
function percent(cell, row) {
  return fixed(cell, Number(row.episodes ?? 100) >= 400 ? 1 : 0, 100);
}

function seconds(cell, row) {
  const limit = DATA.scenarios[row.scenario].limit;
  return Number(cell) >= limit - 1e-9 ? `> ${short(String(limit))}` : fixed(cell, 2);
}

const RESULT_COLUMNS = [
  { title: "scenario", value: "scenario", word: true },
  { title: "policy", value: "policy", word: true },
  { title: "starts", value: "episodes", show: (cell) => cell },
  { title: "met %", value: "success", range: ["success_low", "success_high"], show: percent },
  { title: "met cleanly %", value: "clean_success", range: ["clean_low", "clean_high"],
    show: percent, bar: true },
  { title: "median time s", value: "median_time", range: ["time_low", "time_high"],
    show: seconds },
  { title: "time/bound", value: "time_over_bound", show: short },
  { title: "path m", value: "path_length", show: (cell) => fixed(cell, 1) },
  { title: "contacts", value: "contacts", show: (cell) => fixed(cell, 1) },
  { title: "clearance m", value: "min_clearance", show: (cell) => fixed(cell, 2) },
  { title: "V rise m²/s", value: "max_rise_between_merges",
    show: (cell) => (Number(cell) <= 1e-9 ? "none" : short(cell)) },
  { title: "alignment", value: "min_alignment", show: (cell) => fixed(cell, 2) },
];

const PAIRED_COLUMNS = [
  { title: "scenario", value: "scenario", word: true },
  { title: "policy", value: "policy", word: true },
  { title: "against", value: "against", word: true },
  { title: "difference, clean %", value: "clean_difference",
    range: ["clean_difference_low", "clean_difference_high"], show: percent },
  { title: "better on a start, %", value: "probability_of_improvement",
    range: ["improvement_low", "improvement_high"], show: percent, bar: true },
];

/** Fill a table; the returned function shows one scenario, or all for "". */
function sortableTable(table, columns, rows) {
  const body = make("tbody");
  const lines = rows.map((row) => ({ row, element: tableRow(columns, row) }));
  let shown = "";
  const show = () => {
    const found = lines.filter(({ row }) => !shown || row.scenario === shown);
    found.forEach(({ row, element }, place) =>
      element.classList.toggle("first",
        place > 0 && found[place - 1].row.scenario !== row.scenario));
    body.replaceChildren(...found.map(({ element }) => element));
  };
  const heads = columns.map((column) => {
    const head = make("th", { scope: "col", className: column.word ? "word" : "" });
    const button = make("button", { type: "button", textContent: column.title });
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      lines.sort((a, b) => inOrder(a.row[column.value], b.row[column.value], column, down));
      show();
    });
    head.append(button);
    return head;
  });
  table.replaceChildren(make("thead", {}, make("tr", {}, ...heads)), body);
  show();
  return (scenario) => {
    shown = scenario;
    show();
  };
}

/** Words by letter, numbers by size, empty cells last either way. */
function inOrder(a, b, column, down) {
  if (a === "" || b === "") return (a === "") - (b === "");
  const order = column.word ? a.localeCompare(b) : Number(a) - Number(b);
  return down ? -order : order;
}

function tableRow(columns, row) {
  return make("tr", {}, ...columns.map((column) => {
    const cell = row[column.value];
    const box = make("td", { className: column.word ? "word" : "" });
    box.dataset.column = column.value;
    box.dataset.value = cell;
    if (column.word) box.textContent = cell;
    else box.append(make("span", { textContent: column.show(cell, row) }));
    if (!column.range) return box;
    const [low, high] = column.range.map((name) => row[name]);
    Object.assign(box.dataset, { low, high });
    if (low === "" || high === "") return box;
    const ends = [low, high].map((end) => column.show(end, row)).join(", ");
    box.append(make("span", { className: "range", textContent: `[${ends}]` }));
    if (column.bar) box.append(bar(Number(cell), Number(low), Number(high)));
    return box;
  }));
}

/** An interval between 0 and 1 as a picture. */
function bar(value, low, high) {
  const range = make("i");
  range.style.left = `${100 * low}%`;
  range.style.width = `${100 * (high - low)}%`;
  const mark = make("b");
  mark.style.left = `${100 * value}%`;
  const box = make("span", { className: "bar" }, range, mark);
  box.setAttribute("aria-hidden", "true");
  return box;
}

function showTables() {
  const fill = (name, columns) =>
    sortableTable(document.getElementById(`${name}-table`), columns, DATA[name]);
  const filters = [fill("results", RESULT_COLUMNS), fill("paired", PAIRED_COLUMNS)];
  const choice = document.getElementById("table-scenario");
  for (const name of Object.keys(DATA.scenarios)) choice.append(make("option", { value: name, textContent: name }));
  choice.addEventListener("change", () => filters.forEach((filter) => filter(choice.value)));
}

showTables();
