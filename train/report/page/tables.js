// Sortable tables; every cell carries the text of the file that it is from.

const MINUS = (text) => text.replaceAll("-", "−");

/** A number to so many digits after the point, without a sign on a rounded zero. */
function fixed(cell, digits, factor = 1) {
  if (cell === "") return "–";
  const text = (factor * Number(cell)).toFixed(digits);
  return MINUS(Number(text) === 0 ? text.replace("-", "") : text);
}

/** A length, to so many digits after the point, or to two that count where these would be zeros. */
function metres(cell, digits) {
  const isSmall = Number(cell) !== 0 && Math.abs(Number(cell)) < 10 ** -digits;
  return isSmall ? short(cell) : fixed(cell, digits);
}

/** A clearance, m; that of a contact is 0 but for rounding. */
function clearance(cell, { scenario }) {
  const isContact = cell !== "" && Math.abs(Number(cell)) < DATA.scenarios[scenario].contact;
  return isContact ? fixed("0", 2) : metres(cell, 2);
}

/** A number beside an axis. */
function tick(value) {
  return MINUS(String(Number(value.toPrecision(6))));
}

function short(cell) {
  return cell === "" ? "–" : MINUS(String(Number(Number(cell).toPrecision(2))));
}

/** Percent with one digit where there are enough starts to mean it. */
function percent(cell, row) {
  return fixed(cell, Number(row.episodes ?? 100) >= 400 ? 1 : 0, 100);
}

// Columns: best says which end is the better one, 1 the largest, -1 the least; words begin with a.
// key: shown on a narrow screen too. link: of a row, an element that leads somewhere, or null.
// names: says its scenario where there is no room for that column.

/**
 * Fill a table; show(scenario) of what is returned shows one scenario, or all for "", and rows()
 * are the rows in the order in which they stand there.
 */
function sortableTable(table, columns, rows) {
  const body = make("tbody");
  const lines = rows.map((row) => ({ row, element: tableRow(columns, row) }));
  let shown = "";
  const found = () => lines.filter(({ row }) => !shown || row.scenario === shown);
  const show = () => {
    found().forEach(({ row, element }, place, all) =>
      element.classList.toggle("first", place > 0 && all[place - 1].row.scenario !== row.scenario));
    body.replaceChildren(...found().map(({ element }) => element));
  };
  const heads = columns.map((column) => {
    const head = make("th", { scope: "col", className: classOf(column) });
    const button = make("button", { type: "button", textContent: column.title });
    button.addEventListener("click", () => {
      const first = column.best === 1 ? "descending" : "ascending";
      const other = column.best === 1 ? "ascending" : "descending";
      const order = head.getAttribute("aria-sort") === first ? other : first;
      heads.forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", order);
      lines.sort((a, b) =>
        inOrder(a.row[column.value], b.row[column.value], column, order === "descending"));
      show();
    });
    head.append(button);
    return head;
  });
  table.append(make("thead", {}, make("tr", {}, ...heads)), body);
  show();
  return {
    show: (scenario) => {
      shown = scenario;
      show();
    },
    rows: () => found().map(({ row }) => row),
  };
}

function classOf({ word, key, wraps }) {
  return [word && "word", !key && "more", wraps && "wraps"].filter(Boolean).join(" ");
}

/** Words by letter, numbers by size, empty cells last either way. */
function inOrder(a, b, column, down) {
  if (a === "" || b === "") return (a === "") - (b === "");
  const order = column.word ? a.localeCompare(b) : Number(a) - Number(b);
  return down ? -order : order;
}

function tableRow(columns, row) {
  const line = make("tr", {}, ...columns.map((column) => tableCell(column, row)));
  const first = line.querySelector("a");
  if (first) {
    line.classList.add("replays");
    line.addEventListener("click", ({ target }) => {
      const link = target.closest("td").querySelector("a") ?? first; // the cell's own, if it has one
      if (target !== link && !String(getSelection())) link.click();
    });
  }
  return line;
}

function tableCell(column, row) {
  const cell = row[column.value];
  const box = make("td", { className: classOf(column) });
  box.dataset.column = column.value;
  box.dataset.value = cell;
  if (column.names) box.dataset.scenario = row.scenario;
  if (column.link) box.append(column.link(row) ?? cell);
  else if (column.word) box.textContent = cell;
  else box.append(make("span", { textContent: column.show(cell, row) }));
  if (!column.range) return box;
  const [low, high] = column.range.map((name) => row[name]);
  Object.assign(box.dataset, { low, high });
  if (low === "" || high === "") return box;
  const ends = [low, high].map((end) => column.show(end, row)).join(", ");
  box.append(make("span", { className: "range", textContent: `[${ends}]` }));
  if (column.bar) box.append(bar(Number(cell), Number(low), Number(high)));
  return box;
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

/** What stands above tables, by name: which scenario to show, CSV, all columns on a narrow screen. */
function controls(tables, scenarios) {
  const choice = find("table-scenario");
  for (const name of scenarios)
    choice.append(make("option", { value: name, textContent: name }));
  choice.addEventListener("change", () =>
    Object.values(tables).forEach(({ show }) => show(choice.value)));
  for (const button of document.querySelectorAll("button.csv")) {
    const { table: name } = button.dataset;
    button.addEventListener("click", () =>
      save(`${name}.csv`, new Blob([csvOf(tables[name].rows())], { type: "text/csv" })));
  }
  find("all-columns").addEventListener("click", ({ target }) => {
    const all = document.body.classList.toggle("all-columns");
    target.setAttribute("aria-pressed", all);
  });
}
