// The page of a study: plots of metrics against settings, a table of all runs, trajectories.
"use strict";
congelation.study = (() => {
  const {state, scales, model, css, each, number, place, shown} = congelation;
  const study = state.study;
  const value = (v) => (v === "inf" ? Infinity : v === "-inf" ? -Infinity : v);
  const columns = Object.fromEntries(
    Object.entries(study.columns).map(([name, list]) => [name, list.map(value)]));
  const count = study.run_id.length;
  const all = Array.from({length: count}, (_, k) => k);
  const name = (k) => study.labels[k] ?? k;
  // What is infinite: of settling times "not settled", else ∞.
  const infinite = (k) => (study.settling.includes(k) ? study.not_settled : "∞");
  const text = (k, v) => (v === Infinity ? infinite(k) : number(v));
  const chosen = (id) => document.getElementById(id).value;
  let kept = all;     // the runs that pass the filters, in the order of the table
  let order = null;   // {column, down}
  let first = 0;      // the first row shown
  const ROWS = 25;
  const DIGITS = 8;   // of an id, as many as `congelation show` needs; the rows' titles have all

  const isNumber = (v) => typeof v === "number" && !Number.isNaN(v);
  function scaleOf(values, of, wish = "auto") {
    const finite = values.filter((v) => isNumber(v) && Number.isFinite(v));
    const low = Math.min(...finite), high = Math.max(...finite);
    const decades = finite.length > 0 && low > 0 && high >= 30 * low;
    const mode = wish === "auto" ? (decades ? "log" : "linear")
      : wish === "log" && !(low > 0) ? "linear" : wish;
    const scale = {own: true, mode};
    if (values.includes(Infinity)) {
      const a = place(scale, finite.length ? low : 0), b = place(scale, finite.length ? high : 1);
      scale.ceiling = b + 0.15 * (b - a || 1);
      scale.above = infinite(of);
    }
    return scale;
  }
  function axisScale(values, axis) {  // of a setting: numbers as they are, all else by its name
    if (values.every((v) => isNumber(v) || v === null)) return scaleOf(values, axis);
    const names = [...new Set(values.map((v) => String(v)))].sort();
    return {own: true, mode: "linear", names};
  }
  const put = (scale, v) => (scale.names ? scale.names.indexOf(String(v)) : place(scale, v));

  // A quantile that is one of the values, so that an infinite one does no harm.
  const quantile = (sorted, q) => sorted[Math.max(0, Math.ceil(q * sorted.length) - 1)];
  // Of an even number of values the mean of the two middle ones, as in the sentences and tables.
  const median = (sorted) =>
    (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;

  function drawMetric() {
    const axis = chosen("metric-axis"), metric = chosen("metric-metric");
    const band = Number(chosen("metric-band")), timed = study.settling.includes(metric);
    const xs = columns[axis], ys = columns[metric];
    const usable = kept.filter((k) => isNumber(ys[k]) && xs[k] !== null);
    const x = scales["metric.x"] = axisScale(usable.map((k) => xs[k]), axis);
    const y = scales["metric.y"] = scaleOf(usable.map((k) => ys[k]), metric, chosen("metric-scale"));
    const lines = [];
    state.variants.forEach((variant, v) => {
      const runs = usable.filter((k) => study.variant[k] === v && shown.has(v));
      const groups = new Map();
      for (const k of runs) {
        const key = put(x, xs[k]);
        if (!groups.has(key)) groups.set(key, []);
        groups.get(key).push(k);
      }
      let at = [...groups.keys()].sort((a, b) => a - b);
      // A random axis has a value for each run: medians are of equal parts of it.
      if (at.length > 40) {
        const parts = Array.from({length: 20}, () => []);
        at.forEach((key, i) => parts[Math.floor((i * 20) / at.length)].push(...groups.get(key)));
        groups.clear();
        for (const part of parts) {
          const middle = part.map((k) => put(x, xs[k])).sort((a, b) => a - b);
          groups.set(median(middle), part);
        }
        at = [...groups.keys()].sort((a, b) => a - b);
      }
      const line = {x: [], median: [], low: [], high: []};
      for (const key of at) {
        const sorted = groups.get(key).map((k) => ys[k]).sort((a, b) => a - b);
        const three = [quantile(sorted, 0.5 - band / 2), median(sorted), quantile(sorted, 0.5 + band / 2)];
        line.x.push(key);
        ["low", "median", "high"].forEach((part, i) => line[part].push(place(y, three[i])));
        const failed = sorted.filter((s) => s === Infinity).length;
        lines.push([variant, congelation.tick("metric.x", key), ...three.map((s) => text(metric, s)),
          timed ? `${sorted.length - failed} of ${sorted.length}` : String(sorted.length)]);
      }
      model(`metric.line.${v}`).data = line;
      model(`metric.points.${v}`).data = points(runs, axis, metric, x, y);
    });
    const seen = usable.filter((k) => shown.has(study.variant[k]));
    frame("metric", seen.map((k) => put(x, xs[k])), seen.map((k) => place(y, ys[k])));
    axes("metric", axis, metric);
    const single = lines.every((line) => /^(1|[01] of 1)$/.test(line[5]));  // of one run each
    fill("metric-numbers", ["variant", name(axis),
      ...(single ? [name(metric)] : ["low", "median", "high", timed ? "settled" : "runs"])],
      single ? lines.map((line) => [line[0], line[1], line[3]]) : lines);
  }
  function points(runs, a, b, x, y) {
    return {x: runs.map((k) => put(x, columns[a][k])), y: runs.map((k) => put(y, columns[b][k])),
      row: runs, a: runs.map((k) => `${name(a)} = ${text(a, columns[a][k])}`),
      b: runs.map((k) => `${name(b)} = ${text(b, columns[b][k])}`),
      run: runs.map((k) => study.run_id[k])};
  }
  function frame(plot, xs, ys) {  // show these points, with a margin
    const found = model(plot);
    [[found.x_range, xs], [found.y_range, ys]].forEach(([range, places]) => {
      const seen = places.filter(Number.isFinite);
      const low = seen.length ? Math.min(...seen) : 0, high = seen.length ? Math.max(...seen) : 1;
      const margin = 0.06 * (high - low) || 0.5;
      const [start, end] = [low - margin, high + margin];
      range.setv({start, end, reset_start: start, reset_end: end});
    });
  }
  function axes(plot, x, y) {
    const found = model(plot);
    found.below[0].axis_label = name(x);
    found.left[0].axis_label = name(y);
  }

  function drawMap() {
    const a = chosen("map-x"), b = chosen("map-y"), metric = chosen("map-metric");
    const v = Number(chosen("map-variant"));
    const runs = kept.filter((k) => study.variant[k] === v && isNumber(columns[metric][k]));
    const steps = (axis) => {
      const found = [...new Set(runs.map((k) => columns[axis][k]))].sort((p, q) =>
        isNumber(p) && isNumber(q) ? p - q : String(p) < String(q) ? -1 : 1);
      if (found.length <= 40) return {names: found.map((f) => number(f)), of: (f) => found.indexOf(f)};
      const low = found[0], width = (found[found.length - 1] - low) / 20;  // a random axis: 20 parts
      return {names: Array.from({length: 20}, (_, i) => number(Number((low + (i + 0.5) * width).toPrecision(3)))),
        of: (f) => Math.min(19, Math.floor((f - low) / width))};
    };
    const x = steps(a), y = steps(b);
    scales["map.x"] = {own: true, mode: "linear", names: x.names};
    scales["map.y"] = {own: true, mode: "linear", names: y.names};
    const cells = new Map();
    for (const k of runs) {
      const key = `${x.of(columns[a][k])} ${y.of(columns[b][k])}`;
      if (!cells.has(key)) cells.set(key, []);
      cells.get(key).push(columns[metric][k]);
    }
    const medians = new Map([...cells].map(([key, list]) =>
      [key, median(list.sort((p, q) => p - q))]));
    const scale = scaleOf([...medians.values()], metric);
    const drawn = [...medians.values()].filter(Number.isFinite).map((m) => place(scale, m));
    const low = Math.min(...drawn), high = Math.max(...drawn);
    const shade = (m) => (Number.isFinite(m)
      ? study.palette[Math.round(255 * (high > low ? (place(scale, m) - low) / (high - low) : 0.5))]
      : css("--ground"));
    const data = {x: [], y: [], fill: [], hatch: [], ink: [], label: [], a: [], b: []};
    for (const [key, m] of medians) {
      const [i, j] = key.split(" ").map(Number);
      data.x.push(i); data.y.push(j); data.fill.push(shade(m));
      data.hatch.push(Number.isFinite(m) ? " " : "/");
      const part = (place(scale, m) - low) / (high - low);
      data.ink.push(!Number.isFinite(m) ? css("--text") : part < 0.55 ? "#ffffff" : "#000000");
      data.label.push(medians.size <= 100 ? text(metric, m) : "");
      data.a.push(`${name(a)} = ${x.names[i]}, ${name(b)} = ${y.names[j]}`);
      data.b.push(`${name(metric)} = ${text(metric, m)}`);
    }
    const found = model("map");
    found.x_range.setv({start: -0.5, end: x.names.length - 0.5});
    found.y_range.setv({start: -0.5, end: y.names.length - 0.5});
    model("map.cells").data = data;
    axes("map", a, b);
    fill("map-numbers", [`${name(b)} \\ ${name(a)}`, ...x.names], y.names.map((label, j) =>
      [label, ...x.names.map((_, i) => text(metric, medians.get(`${i} ${j}`)))]));
  }

  function drawPareto() {
    const a = chosen("pareto-x"), b = chosen("pareto-y");
    const usable = kept.filter((k) => Number.isFinite(columns[a][k]) && Number.isFinite(columns[b][k])
      && isNumber(columns[a][k]) && isNumber(columns[b][k]) && shown.has(study.variant[k]));
    const x = scales["pareto.x"] = scaleOf(usable.map((k) => columns[a][k]), a);
    const y = scales["pareto.y"] = scaleOf(usable.map((k) => columns[b][k]), b);
    const lines = [];
    const pooled = document.getElementById("pareto-pool").checked;
    const best = (runs) => {
      const front = [];
      let least = Infinity;
      for (const k of [...runs].sort((p, q) => columns[a][p] - columns[a][q]
        || columns[b][p] - columns[b][q]))
        if (columns[b][k] < least) { least = columns[b][k]; front.push(k); }
      return front;
    };
    const whole = pooled ? new Set(best(usable)) : null;
    state.variants.forEach((variant, v) => {
      const runs = usable.filter((k) => study.variant[k] === v);
      const front = pooled ? best(usable).filter((k) => whole.has(k) && study.variant[k] === v)
                           : best(runs);
      model(`pareto.points.${v}`).data = points(runs, a, b, x, y);
      model(`pareto.line.${v}`).data = points(front, a, b, x, y);
      for (const k of front)
        lines.push([variant, cells.run(k), text(a, columns[a][k]), text(b, columns[b][k])]);
    });
    frame("pareto", usable.map((k) => put(x, columns[a][k])), usable.map((k) => put(y, columns[b][k])));
    axes("pareto", a, b);
    fill("pareto-numbers", ["variant", "run not beaten", name(a), name(b)], lines);
  }

  // Tables.
  function element(kind, content, attributes = {}) {
    const made = document.createElement(kind);
    for (const [key, v] of Object.entries(attributes)) made.setAttribute(key, v);
    made.textContent = content;
    return made;
  }
  function fill(id, heads, lines) {
    const table = document.getElementById(id);
    const head = document.createElement("tr");
    // A name may be broken after its dots: sine.amplitude.
    heads.forEach((h) => head.append(element("th", h.replaceAll(".", ".\u200b"), {scope: "col"})));
    table.tHead.replaceChildren(head);
    table.tBodies[0].replaceChildren(...lines.slice(0, 200).map((line) => {
      const row = document.createElement("tr");
      line.forEach((cell, i) => row.append(element(i ? "td" : "th", cell, i ? {} : {scope: "row"})));
      return row;
    }));
  }
  const cells = {
    run: (k) => study.run_id[k].slice(0, DIGITS), variant: (k) => state.variants[study.variant[k]],
    status: (k) => study.status[k],
  };
  const cell = (column, k) => (cells[column] ? cells[column](k) : columns[column][k]);
  function filter() {
    const wanted = chosen("filter-text").trim().toLowerCase();
    const status = chosen("filter-status");
    // "omega > 10" compares a column; any other text is looked for in a row.
    const asked = /^(.+?)\s*(<=|>=|<|>|=)\s*(.+)$/.exec(wanted);
    const column = asked && study.table.find((c) => c.toLowerCase() === asked[1]
      || name(c).toLowerCase().replace(/ \[.*/, "") === asked[1]);
    const compare = {"<": (a, b) => a < b, ">": (a, b) => a > b, "=": (a, b) => a === b,
      "<=": (a, b) => a <= b, ">=": (a, b) => a >= b};
    const limit = asked && ([study.not_settled, "∞"].includes(asked[3]) ? Infinity
      : Number.isNaN(Number(asked[3])) ? asked[3] : Number(asked[3]));
    kept = all.filter((k) => {
      if (status && study.status[k] !== status) return false;
      if (!wanted) return true;
      if (column) {
        const v = cell(column, k);
        return v !== null && compare[asked[2]](typeof v === "string" ? v.toLowerCase() : v, limit);
      }
      return study.table.some((c) => String(text(c, cell(c, k))).toLowerCase().includes(wanted));
    });
    if (order) kept.sort((p, q) => {
      const [a, b] = [cell(order.column, p), cell(order.column, q)];
      const empty = (v) => v === null || v === undefined;
      if (empty(a) || empty(b)) return empty(a) - empty(b);
      return (a < b ? -1 : a > b ? 1 : 0) * (order.down ? -1 : 1);
    });
    first = 0;
    rows();
  }
  function rows() {
    const table = document.getElementById("runs");
    each("#runs thead th", (head) => {
      const by = order && order.column === head.dataset.column;
      head.setAttribute("aria-sort", by ? (order.down ? "descending" : "ascending") : "none");
      head.querySelector("span").textContent = by ? (order.down ? " ▾" : " ▴") : "";
    });
    const listed = kept.filter((k) => shown.has(study.variant[k]));
    first = Math.max(0, Math.min(first, listed.length - 1));
    table.tBodies[0].replaceChildren(...listed.slice(first, first + ROWS).map((k) => {
      const row = element("tr", "", {tabindex: "0", class: "open", "data-run": study.run_id[k],
        title: `run ${study.run_id[k]}`});
      for (const column of study.table)
        row.append(element("td", text(column, cell(column, k)),
          cells[column] ? {class: "text"} : {}));
      row.addEventListener("click", () => open(k));
      row.addEventListener("keydown", (event) => { if (event.key === "Enter") open(k); });
      return row;
    }));
    document.getElementById("runs-shown").textContent = listed.length
      ? `${first + 1} to ${Math.min(first + ROWS, listed.length)} of ${listed.length} runs`
        + (listed.length < count ? ` (${count} in all)` : "")
      : `none of ${count} runs`;
  }

  // A curve of the run that is picked: its points, and its row in the table beside the plot.
  const floats = (text) =>
    new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  function fillCurve(cell, held) {
    const curve = held[cell.dataset.curve], row = cell.parentElement;
    row.hidden = !curve;
    model(cell.dataset.curve).data = curve
      ? {time: floats(curve.time), value: floats(curve.value)} : {time: [], value: []};
    row.querySelectorAll("td:not([data-curve])").forEach((found, i) => {
      const value = curve ? curve.numbers[i] : null;
      found.textContent = value === null ? "–" : number(Number(Number(value).toPrecision(3)));
    });
    cell.textContent = "–";
  }

  // A run that is picked, in a plot or the table: what it was, and its trajectories.
  function open(k) {
    const id = study.run_id[k];
    each("#runs tbody tr", (row) => row.classList.toggle("chosen", row.dataset.run === id));
    const held = study.trajectories[id];
    const settings = study.axes.map((a) => `${name(a)} = ${text(a, columns[a][k])}`).join(", ");
    document.getElementById("picked").textContent =
      `Run ${id}: ${cells.variant(k)}${settings ? `, ${settings}` : ""}; ${study.status[k]}. `
      + (study.message[k] ?? "")
      + (held ? ""
        : study.stored ? ` Its trajectory is not in this page: trajectories/${id}.parquet.`
        : " No trajectories were kept; trajectories = true in [sweep] keeps them.");
    const place = document.getElementById("trajectories");
    place.hidden = !held;
    if (held) {
      document.documentElement.style.setProperty("--picked", `var(--v${study.variant[k] % 8})`);
      place.querySelectorAll("td[data-curve]").forEach((cell) => fillCurve(cell, held));
      congelation.paint();
    }
    document.getElementById("picked").scrollIntoView({block: "nearest"});
  }
  function pick(source) {
    const index = source.selected.indices[0];
    if (index !== undefined && source.data.row) open(source.data.row[index]);
  }

  function refresh() { rows(); draw(); }
  function draw() {
    if (study.axes.length && study.metrics.length) drawMetric();
    if (study.axes.length > 1 && study.metrics.length) drawMap();
    if (study.metrics.length > 1) drawPareto();
  }
  function start() {
    for (const [prefix, act] of [["metric-", drawMetric], ["map-", drawMap], ["pareto-", drawPareto]])
      each(`[id^="${prefix}"]`, (control) => control.addEventListener("change", act));
    each("#runs thead th button", (button) => button.addEventListener("click", () => {
      const column = button.parentElement.dataset.column;
      order = order && order.column === column ? (order.down ? null : {column, down: true})
                                              : {column, down: false};
      filter();
    }));
    document.getElementById("filter-text").addEventListener("input", () => { filter(); draw(); });
    document.getElementById("filter-status").addEventListener("change", () => { filter(); draw(); });
    document.getElementById("runs-back").addEventListener("click", () => { first -= ROWS; rows(); });
    document.getElementById("runs-on").addEventListener("click", () => {
      if (first + ROWS < kept.length) first += ROWS;
      rows();
    });
    rows();
    draw();
  }
  return {start, refresh, open, pick, kept: () => kept.map((k) => study.run_id[k])};
})();
