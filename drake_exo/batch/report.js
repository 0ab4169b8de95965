// The table of a batch: sorted and filtered as numbers, drawn as far as it
// is in view; boxes over subjects of one signal.
(() => {
  "use strict";
  const names = Object.keys(RESULTS.columns);
  const columns = {};
  for (const name of names) {
    const given = RESULTS.columns[name];
    const text = atob(given.data);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    const kind = given.texts ? Uint32Array : Float64Array;
    columns[name] = { texts: given.texts, data: new kind(bytes.buffer) };
  }
  const count = RESULTS.count;
  const ROW = 22;
  const view = document.getElementById("view");
  const space = document.getElementById("space");
  const head = document.getElementById("head");
  const value = columns.value.data;
  const holds = columns.verdict.texts.map((t) => t === "holds");
  const filters = {};
  let order = Uint32Array.from({ length: count }, (_, i) => i);
  let shown = order;
  let sorted = { name: null, down: false };

  // ---------------------------------------------------------- table
  function number(x) {
    if (Number.isNaN(x)) return "";
    const size = Math.abs(x);
    return size !== 0 && (size < 1e-3 || size >= 1e6)
      ? x.toExponential(3) : String(Number(x.toPrecision(5)));
  }

  function accepts(name) {
    const wanted = (filters[name] || "").trim().toLowerCase();
    if (!wanted) return null;
    const column = columns[name];
    if (column.texts) {
      const good = column.texts.map((t) => t.toLowerCase().includes(wanted));
      return (i) => good[column.data[i]];
    }
    const limit = parseFloat(wanted.replace(/^[<>=]+/, ""));
    if (Number.isNaN(limit)) return null;
    if (wanted[0] === ">") return (i) => value[i] > limit;
    if (wanted[0] === "<") return (i) => value[i] < limit;
    return (i) => parseFloat(number(value[i])) === limit; // as it is shown
  }

  function filter() {
    const tests = names.map(accepts).filter((t) => t);
    shown = tests.length
      ? order.filter((i) => tests.every((test) => test(i))) : order;
    space.style.height = `${shown.length * ROW}px`;
    document.getElementById("shown").textContent =
      `${shown.length} of ${count} rows.`;
    draw();
  }

  function sort(name) {
    const down = sorted.name === name && !sorted.down;
    sorted = { name, down };
    const column = columns[name];
    let ranks = value;
    if (column.texts) {
      const places = column.texts.map((_, k) => k);
      places.sort((a, b) => {
        const s = column.texts[a], t = column.texts[b];
        return s < t ? -1 : s > t ? 1 : 0;
      });
      const rank = new Float64Array(places.length);
      places.forEach((k, r) => { rank[k] = r; });
      ranks = Float64Array.from(column.data, (k) => rank[k]);
    }
    const sign = down ? -1 : 1;
    order = Uint32Array.from({ length: count }, (_, i) => i);
    order.sort((a, b) => {
      const x = ranks[a], y = ranks[b];
      // Rows without a number come last either way.
      if (x !== x || y !== y) return (x !== x) - (y !== y) || a - b;
      return sign * (x - y) || a - b;
    });
    for (const button of head.querySelectorAll("button")) {
      const mark = button.dataset.name === name ? (down ? " ▾" : " ▴") : "";
      button.textContent = button.dataset.name + mark;
    }
    filter();
  }

  function cell(name, i) {
    const span = document.createElement("span");
    const column = columns[name];
    const text = column.texts ? column.texts[column.data[i]] : number(value[i]);
    span.className = name;
    span.title = text;
    if (name !== "folder") {
      span.textContent = text;
      return span;
    }
    const link = document.createElement("a");
    link.href = text.split("/").map(encodeURIComponent).join("/") + "/";
    link.textContent = text;
    if (RESULTS.replays[text]) {
      const replay = document.createElement("a");
      replay.href = RESULTS.replays[text];
      replay.textContent = "replay";
      span.append(replay, " ");
    }
    span.append(link);
    return span;
  }

  function draw() {
    const first = Math.max(Math.floor(view.scrollTop / ROW) - 10, 0);
    const last = Math.min(
      first + Math.ceil(view.clientHeight / ROW) + 20, shown.length);
    const rows = [];
    for (let k = first; k < last; k++) {
      const i = shown[k];
      const row = document.createElement("div");
      row.className = holds[columns.verdict.data[i]] ? "row" : "row bad";
      row.style.top = `${k * ROW}px`;
      row.append(...names.map((name) => cell(name, i)));
      rows.push(row);
    }
    space.replaceChildren(...rows);
  }

  // ---------------------------------------------------------- boxes
  const phase = document.getElementById("phase");
  const signal = document.getElementById("signal");
  const by = document.getElementById("by");

  function options(select, texts, wanted) {
    select.replaceChildren(...texts.map((t) => new Option(t, t)));
    const found = wanted.find((w) => texts.includes(w));
    if (found !== undefined) select.value = found;
  }

  function listSignals() {
    const own = columns.phase.texts.indexOf(phase.value);
    const used = new Set();
    for (let i = 0; i < count; i++) {
      if (columns.phase.data[i] === own && !Number.isNaN(value[i])) {
        used.add(columns.signal.data[i]);
      }
    }
    const texts = [...used].map((k) => columns.signal.texts[k]).sort();
    const first = ["rmsd.interaction_n", "rmsd.grf_n.vertical", "rmsd.", "c_"]
      .map((start) => texts.find((t) => t.startsWith(start)));
    options(signal, texts, [signal.value, ...first]);
    boxes();
  }

  function quantile(sortedValues, share) {
    const at = share * (sortedValues.length - 1);
    const low = Math.floor(at);
    const high = Math.min(low + 1, sortedValues.length - 1);
    return sortedValues[low]
      + (at - low) * (sortedValues[high] - sortedValues[low]);
  }

  // One point for each subject (the mean of its rows), a box for each variant;
  // or the rows themselves, a box for each subject.
  function groups() {
    const own = columns.phase.texts.indexOf(phase.value);
    const what = columns.signal.texts.indexOf(signal.value);
    const bySubject = by.value === "subject";
    const found = new Map();
    let unit = "";
    for (let i = 0; i < count; i++) {
      if (columns.phase.data[i] !== own || columns.signal.data[i] !== what
          || Number.isNaN(value[i])) continue;
      unit = columns.unit.texts[columns.unit.data[i]];
      const box = bySubject ? columns.subject.data[i] : columns.variant.data[i];
      const point = bySubject ? i : columns.subject.data[i];
      if (!found.has(box)) found.set(box, new Map());
      const points = found.get(box);
      if (!points.has(point)) points.set(point, []);
      points.get(point).push(value[i]);
    }
    const texts = bySubject ? columns.subject.texts : columns.variant.texts;
    return { unit, boxes: [...found].map(([k, points]) => ({
      label: texts[k] || "all",
      values: [...points.values()]
        .map((v) => v.reduce((a, b) => a + b, 0) / v.length)
        .sort((a, b) => a - b),
    })) };
  }

  function boxes() {
    const { unit, boxes: found } = groups();
    const place = document.getElementById("boxes");
    const most = 40;
    const note = found.length > most ? `first ${most} of ${found.length}` : "";
    document.getElementById("box-note").textContent = note;
    const drawn = found.slice(0, most);
    if (!drawn.length) {
      place.replaceChildren();
      return;
    }
    const all = drawn.flatMap((b) => b.values);
    let low = Math.min(...all), high = Math.max(...all);
    if (low > 0 && low < 0.5 * high) low = 0;
    if (high === low) { high += 1; low -= 1; }
    const width = 560, left = 260, line = 24;
    const x = (v) => (left + width * (v - low) / (high - low)).toFixed(1);
    const parts = [];
    for (let k = 0; k <= 4; k++) {
      const v = low + k * (high - low) / 4;
      const y = drawn.length * line;
      parts.push(`<line x1="${x(v)}" x2="${x(v)}" y1="0" y2="${y}" stroke="#ddd"/>`
        + `<text x="${x(v)}" y="${y + 14}" text-anchor="middle">${number(v)}</text>`);
    }
    drawn.forEach((box, k) => {
      const y = k * line + line / 2, v = box.values;
      const [a, b, c] = [0.25, 0.5, 0.75].map((q) => quantile(v, q));
      const reach = 1.5 * (c - a);
      const ends = v.filter((u) => u >= a - reach && u <= c + reach);
      const label = document.createElement("span");
      label.textContent = box.label.slice(-42);
      parts.push(
        `<text x="${left - 8}" y="${y + 4}" text-anchor="end">${label.innerHTML} (${v.length})</text>`,
        `<line x1="${x(ends[0])}" x2="${x(ends[ends.length - 1])}" y1="${y}" y2="${y}" stroke="#0072B2"/>`,
        `<rect x="${x(a)}" y="${y - 7}" width="${Math.max(x(c) - x(a), 1)}" height="14" fill="#cfe2f3" stroke="#0072B2"/>`,
        `<line x1="${x(b)}" x2="${x(b)}" y1="${y - 7}" y2="${y + 7}" stroke="#D55E00" stroke-width="2"/>`,
        ...v.map((u) => `<circle cx="${x(u)}" cy="${y}" r="2" fill="#222" fill-opacity="0.5"/>`));
    });
    place.innerHTML = `<svg width="${left + width + 80}" height="${drawn.length * line + 22}">`
      + `${parts.join("")}<text x="${left + width + 36}" y="${drawn.length * line + 14}">${unit}</text></svg>`;
  }

  // ---------------------------------------------------------- start
  for (const name of names) {
    const button = document.createElement("button");
    button.textContent = button.dataset.name = name;
    button.addEventListener("click", () => sort(name));
    head.append(button);
  }
  for (const name of names) {
    const input = document.createElement("input");
    input.setAttribute("aria-label", `filter ${name}`);
    input.addEventListener("input", () => {
      filters[name] = input.value;
      view.scrollTop = 0;
      filter();
    });
    input.id = `filter-${name}`;
    head.append(input);
  }
  view.addEventListener("scroll", draw);
  window.addEventListener("resize", draw);
  phase.addEventListener("change", listSignals);
  signal.addEventListener("change", boxes);
  by.addEventListener("change", boxes);
  const phases = [...columns.phase.texts].sort();
  options(phase, phases, ["predict", "crossvalidate", "calibrate"]);
  listSignals();
  filter();
  document.body.dataset.readyMs = Math.round(performance.now());
  // For tests and links: report.html#sort=value&filter-signal=rmsd
  for (const [key, wanted] of new URLSearchParams(location.hash.slice(1))) {
    const begun = performance.now();
    if (key === "sort") sort(wanted);
    const input = document.getElementById(key);
    if (input) {
      input.value = wanted;
      input.dispatchEvent(new Event("input"));
    }
    document.body.dataset[key.replace("-", "") + "Ms"] =
      Math.round(performance.now() - begun);
  }
})();
