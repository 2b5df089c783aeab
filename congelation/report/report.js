// What the pages do in the browser. Bokeh draws; the controls are plain HTML elements, which
// keyboards and screen readers know. Nothing here asks anything of the network.
"use strict";
window.congelation = (() => {
  const state = JSON.parse(document.getElementById("state").textContent);
  const scales = state.scales;  // by plot: {mode: "linear" | "symlog", threshold}
  let bokeh = null;

  const model = (name) => bokeh.get_model_by_name(name);
  let paper = false;  // whether the page is about to be printed
  const light = [...document.styleSheets[0].cssRules].find((r) => r.selectorText === ":root").style;
  const css = (name) => (paper ? light : getComputedStyle(document.documentElement))
    .getPropertyValue(name).trim();
  const shared = {"-1": "--every", "-2": "--picked"};
  const colour = (variant) => css(shared[variant] ?? `--v${variant % 8}`);
  const each = (selector, act) => document.querySelectorAll(selector).forEach(act);

  function number(value) {
    if (value === null || value === undefined || Number.isNaN(value)) return "–";
    if (typeof value !== "number") return String(value);
    if (value === Infinity) return "∞";
    if (value === -Infinity) return "-∞";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e5))
      return value.toExponential(3).replace(/\.?0*e/, "e").replace("e+", "e");
    return String(Number(value.toPrecision(4)));
  }

  // Axes. The data stay as they are; a plot's scale says where a value is drawn: as it is, by
  // log10 ("log"), or by sign(v) log10(1 + |v| / threshold) ("symlog"). What is infinite is drawn
  // on a line of its own above the rest, `ceiling`.
  function place(scale, value) {
    if (value === Infinity && scale.ceiling !== undefined) return scale.ceiling;
    if (scale.mode === "log") return value > 0 ? Math.log10(value) : NaN;
    if (scale.mode === "symlog")
      return Math.sign(value) * Math.log10(1 + Math.abs(value) / scale.threshold);
    return value;
  }
  function unplace(scale, y) {
    if (scale.mode === "log") return 10 ** y;
    if (scale.mode === "symlog") return Math.sign(y) * scale.threshold * (10 ** Math.abs(y) - 1);
    return y;
  }
  function even(low, high, count) {
    const raw = (high - low) / count;
    if (!(raw > 0)) return [low];
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((m) => m * power >= raw);
    const ticks = [];
    for (let k = Math.ceil(low / step); k * step <= high; k++) ticks.push(k * step);
    return ticks;
  }
  function decades(scale, low, high) {
    const ticks = [];
    const add = (sign, from, to) => {
      for (let k = from; k <= to; k++) ticks.push(sign * 10 ** k);
    };
    if (scale.mode === "log") {
      add(1, Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9));
      return ticks;
    }
    const first = Math.floor(Math.log10(scale.threshold)) + 1;
    if (high > 0) add(1, first, Math.floor(Math.log10(high)));
    if (low < 0) add(-1, first, Math.floor(Math.log10(-low)));
    return ticks.filter((t) => t >= low && t <= high).concat(low <= 0 && high >= 0 ? [0] : []);
  }
  function ticks(name, start, end) {
    const scale = scales[name];
    if (scale.names) {  // of many names every second one, or third.., so that they do not touch
      const every = name.endsWith(".x") ? Math.ceil(scale.names.join("").length / 45) : 1;
      return scale.names.map((_, k) => k).filter((k) => k % every === 0);
    }
    const top = scale.ceiling === undefined ? end : Math.min(end, scale.ceiling - 1e-9);
    let found;
    if (scale.mode === "linear") found = even(start, top, 5);
    else {
      const low = unplace(scale, start), high = unplace(scale, top);
      found = decades(scale, low, high);
      if (scale.mode === "log" && found.length < 3)  // 1, 2, 5, 10, 20, ..
        for (let k = Math.floor(Math.log10(low)); 10 ** k <= high; k++)
          found.push(...[2, 5].map((m) => m * 10 ** k).filter((v) => v >= low && v <= high));
      if (found.length < 2) found = even(low, high, 4);
      found = found.map((v) => place(scale, v)).sort((a, b) => a - b);
      const apart = (end - start) / 9;  // labels closer than that would touch
      const kept = [];
      for (const y of found.reverse())
        if (!kept.length || kept[kept.length - 1] - y >= apart) kept.push(y);
      found = kept.reverse();
    }
    if (scale.ceiling !== undefined && end >= scale.ceiling)
      found = found.filter((y) => scale.ceiling - y > (end - start) / 12).concat(scale.ceiling);
    return found;
  }
  function tick(name, y) {
    const scale = scales[name];
    if (scale.names) return scale.names[Math.round(y)] ?? "";
    if (scale.ceiling !== undefined && Math.abs(y - scale.ceiling) < 1e-9) return scale.above;
    return number(Number(unplace(scale, y).toPrecision(6)));
  }
  function placed(name, values) {
    const scale = scales[name];
    return Float64Array.from(values, (value) => place(scale, value));
  }

  // Colours follow the reader's choice of light or dark; paper is light.
  function paint() {
    const text = css("--text"), line = css("--line"), ground = css("--ground");
    for (const found of bokeh._all_models.values()) {
      if (found.type === "Figure") found.setv({background_fill_color: ground,
        border_fill_color: ground, border_line_color: ground, outline_line_color: line});
      else if (found.type.endsWith("Axis")) found.setv({axis_label_text_color: text,
        major_label_text_color: text, axis_line_color: line, major_tick_line_color: line,
        minor_tick_line_color: null});
      else if (found.type === "Grid") found.setv({grid_line_color: line, grid_line_alpha: 0.6});
      else if (found.type === "Span") found.line_color = css("--soft");
      else if (found.type === "ColorBar") found.setv({background_fill_color: ground,
        major_label_text_color: text, title_text_color: text});
      else if (found.type === "GlyphRenderer") {
        const [variant] = variantsOf(found);
        if (variant !== undefined) recolour(found, variant);
      }
    }
  }
  function print(on) {  // at once: a browser does not wait for the next frame
    paper = on;
    paint();
    if (window.congelation.study) window.congelation.study.refresh();
    for (const view of Object.values(Bokeh.index)) {
      for (const part of view.renderer_views?.values() ?? []) part.set_visuals?.();
      view.paint?.();
    }
  }
  // Tags "variant 0": whose curve it is, the first in its colour; -1: of all, -2: of the run that
  // is picked.
  const variantsOf = (renderer) => renderer.tags.filter((t) => String(t).startsWith("variant "))
    .map((t) => Number(t.slice(8)));
  function recolour(renderer, variant) {
    const shade = colour(variant);
    for (const glyph of [renderer.glyph, renderer.nonselection_glyph, renderer.selection_glyph]) {
      if (!glyph || typeof glyph === "string") continue;
      const changes = {};
      if ("line_color" in glyph.properties) changes.line_color = {value: shade};
      if ("fill_color" in glyph.properties) changes.fill_color = {value: shade};
      glyph.setv(changes);
    }
  }

  // Which variants are shown: their curves, their rows of numbers.
  const shown = new Set(state.variants.map((_, k) => k));
  function toggle(variant, on) {
    if (on) shown.add(variant); else shown.delete(variant);
    const some = (variants) => variants.some((v) => shown.has(v));
    for (const found of bokeh._all_models.values()) {
      if (found.type !== "GlyphRenderer") continue;
      const variants = variantsOf(found);
      if (variants.includes(variant)) found.visible = some(variants);
    }
    each(`tr[data-variant~="${variant}"]`, (row) => {
      row.hidden = !some(row.dataset.variant.split(" ").map(Number));
    });
    if (window.congelation.study) window.congelation.study.refresh();
  }
  function setMode(mode) {
    for (const [name, scale] of Object.entries(scales)) {
      if (scale.own) continue;
      scale.mode = mode === "auto" ? scale.first : mode;
    }
    for (const found of bokeh._all_models.values())
      if (found.type === "ColumnDataSource") found.change.emit();
  }

  // One cursor in all panels: the tables beside them show every curve's value there.
  function at(times, values, t) {
    let low = 0, high = times.length - 1;
    if (high < 0 || t < times[0] || t > times[high]) return NaN;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle; else high = middle;
    }
    const width = times[high] - times[low];
    return width > 0 ? values[low] + (values[high] - values[low]) * (t - times[low]) / width
                     : values[high];
  }
  let waiting = null;
  function cursor(t) {
    const pending = waiting !== null;
    waiting = t;
    if (!pending) requestAnimationFrame(() => { const due = waiting; waiting = null; move(due); });
  }
  function move(t) {
    if (!Number.isFinite(t)) return;
    for (const found of bokeh._all_models.values())
      if (found.type === "Span" && found.name === "cursor") found.setv({location: t, visible: true});
    each("output.time", (cell) => { cell.textContent = `t = ${number(t)} s`; });
    each("input.time", (slider) => { slider.value = t; });
    each("td[data-curve]", (cell) => {
      const source = model(cell.dataset.curve);
      const value = source ? at(source.data.time, source.data.value, t) : NaN;
      cell.textContent = Number.isNaN(value) ? "–" : number(Number(value.toPrecision(3)));
    });
  }

  function start(found) {
    bokeh = found;
    paint();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      paint();
      if (window.congelation.study) window.congelation.study.refresh();
    });
    window.addEventListener("beforeprint", () => print(true));
    window.addEventListener("afterprint", () => print(false));
    // A finger that drags over a plot scrolls the page; the tools zoom when they are chosen.
    if (matchMedia("(pointer: coarse)").matches)
      for (const m of bokeh._all_models.values())
        if (m.type === "Toolbar") m.active_drag = null;
    each("input[data-toggle]", (box) => {
      box.addEventListener("change", () => toggle(Number(box.dataset.toggle), box.checked));
    });
    each("select.scale", (choice) => {
      choice.addEventListener("change", () => setMode(choice.value));
    });
    each("input.time", (slider) => {
      slider.addEventListener("input", () => move(Number(slider.value)));
    });
    if (window.congelation.study) window.congelation.study.start();
    document.documentElement.dataset.ready = "yes";
  }

  return {state, scales, model, css, colour, paint, each, number, place, placed, ticks, tick, shown,
          recolour, cursor, start, bokeh: () => bokeh};
})();
