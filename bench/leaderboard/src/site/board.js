
// Filters, columns, and another metric to rank by. Without this script all of it is shown.
(() => {
  const form = document.querySelector("form.controls");
  if (!form) return;
  const box = form.closest("details");
  box.hidden = false;
  // On a phone the table comes first.
  box.open = matchMedia("(min-width: 40rem)").matches;
  const tables = [...document.querySelectorAll("table.ranking")];
  const filters = [...form.querySelectorAll("[data-filter]")];
  const metrics = form.querySelector("[data-metric]");
  const names = [...metrics.options].map((option) => option.value);
  let chosen = null;

  function filter() {
    const wanted = Object.fromEntries(filters.map((one) => [one.dataset.filter, one.value]));
    for (const section of document.querySelectorAll("section[data-alignment]")) {
      section.hidden = Boolean(wanted.alignment) && section.dataset.alignment !== wanted.alignment;
    }
    for (const table of tables) {
      for (const line of table.tBodies[0].rows) {
        line.hidden = ["supervision", "images", "origin"].some((key) => wanted[key] && line.dataset[key] !== wanted[key]);
      }
    }
  }

  function columns() {
    for (const box of form.querySelectorAll("[data-column]")) {
      const shown = box.checked;
      if (box.dataset.column === "bounds") {
        document.querySelectorAll("table.ranking td[data-column] small").forEach((one) => { one.hidden = !shown; });
      } else {
        document.querySelectorAll(`table.ranking [data-column="${box.dataset.column}"]`).forEach((one) => { one.hidden = !shown; });
      }
    }
  }

  const SVG = "http://www.w3.org/2000/svg";
  function draw(cell, value, low, high, at, hollow) {
    cell.replaceChildren();
    if (!Number.isFinite(value)) return;
    const svg = document.createElementNS(SVG, "svg");
    svg.setAttribute("class", hollow ? "iv hollow" : "iv");
    svg.setAttribute("viewBox", "0 0 100 14");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("aria-hidden", "true");
    const path = (d, name) => {
      const one = document.createElementNS(SVG, "path");
      one.setAttribute("d", d);
      if (name) one.setAttribute("class", name);
      svg.append(one);
    };
    if (Number.isFinite(low)) path(`M${at(low)} 3v8M${at(low)} 7H${at(high)}M${at(high)} 3v8`);
    path(`M${at(value)} 7h0`, "dot");
    cell.append(svg);
  }

  // Ranks, order and drawn intervals of a metric; undefined for that of each table.
  function rankBy(name) {
    for (const table of tables) {
      const metric = name || table.dataset.first;
      const index = names.indexOf(metric);
      const heading = table.querySelector(`th[data-column="${metric}"]`);
      const lower = heading.hasAttribute("data-lower");
      table.querySelector("th.drawn .of").textContent = metrics.options[index].text;
      const lines = [...table.tBodies[0].rows].map((line) => {
        const cell = line.querySelector(`td[data-column="${metric}"]`);
        const number = (text) => (text === undefined || text === "" ? NaN : Number(text));
        return { line, value: number(cell.dataset.v), low: number(cell.dataset.l), high: number(cell.dataset.h) };
      });
      const all = lines.flatMap((one) => [one.value, one.low, one.high]).filter(Number.isFinite);
      let [least, most] = [Math.min(...all), Math.max(...all)];
      if (!(least < most)) [least, most] = [least - 0.5, most + 0.5];
      const at = (value) => (3 + 94 * (value - least) / (most - least)).toFixed(1);
      for (const { line, value, low, high } of lines) {
        const rank = line.dataset.ranks.split(" ")[index] || "";
        const p = line.dataset.ps.split(" ")[index] || "";
        const [rankCell, pCell] = [line.querySelector("td.rank"), line.querySelector("td.p")];
        for (const [cell, text] of [[rankCell, rank], [pCell, p]]) {
          if (text === "") delete cell.dataset.v; else cell.dataset.v = text;
        }
        rankCell.textContent = rank || "-";
        pCell.textContent = p === "" ? "-" : Number(p) < 0.001 ? "<0.001" : Number(p).toFixed(3);
        line.classList.toggle("best", rank === "1");
        draw(line.querySelector("td.drawn"), value, low, high, at, line.dataset.origin === "published");
      }
      const worth = (value) => (Number.isFinite(value) ? (lower ? value : -value) : Infinity);
      // Measured lines first, as the page has them.
      const kind = (line) => (line.dataset.origin === "measured" ? 0 : 1);
      lines.sort((a, b) => kind(a.line) - kind(b.line) || worth(a.value) - worth(b.value) || 0);
      table.tBodies[0].append(...lines.map((one) => one.line));
      table.querySelectorAll("th[aria-sort]").forEach((one) => one.setAttribute("aria-sort", "none"));
    }
  }

  // The choice stands in the address, so that it can be passed on.
  function remember() {
    const parts = filters.filter((one) => one.value).map((one) => `${one.dataset.filter}=${encodeURIComponent(one.value)}`);
    if (chosen) parts.push(`metric=${chosen}`);
    const address = parts.length ? `?${parts.join("&")}` : location.pathname.split("/").pop();
    try { history.replaceState(null, "", address + location.hash); } catch { /* Some browsers refuse on files. */ }
  }

  const asked = new URLSearchParams(location.search);
  for (const one of filters) {
    const value = asked.get(one.dataset.filter);
    if ([...one.options].some((option) => option.value === value)) one.value = value;
    one.addEventListener("change", () => { filter(); remember(); });
  }
  for (const box of form.querySelectorAll("[data-column]")) box.addEventListener("change", columns);
  if (tables.length) metrics.value = tables[0].dataset.first;
  metrics.addEventListener("change", () => { chosen = metrics.value; rankBy(chosen); remember(); });
  if (names.includes(asked.get("metric"))) {
    chosen = metrics.value = asked.get("metric");
    rankBy(chosen);
  }
  filter();
})();
