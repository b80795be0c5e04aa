"use strict";
// Exploring a page: tables that sort and filter, and one lift with linked plots and its film. Without this
// program the page shows the same figures one below the other. Text reaches the page as text, never as HTML.
(() => {
  const root = document.documentElement;
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const colour = name => name && (getComputedStyle(root).getPropertyValue(`--${name}`).trim() || name);
  const made = (tag, values = {}) => Object.assign(document.createElement(tag), values);
  const parsed = text => parseFloat(text.replace("%", "").replace("−", "-"));
  const ticked = (u, values) => values.map(value => value == null ? "" : number(value));
  root.classList.add("explorable");

  // --- tables -------------------------------------------------------------------------------------------
  function sortable(table) {
    const body = table.tBodies[0];
    all("thead th", table).forEach((head, column) => {
      const button = made("button", {type: "button", textContent: head.textContent, title: "Sort"});
      head.replaceChildren(button);
      button.onclick = () => {
        const falling = head.getAttribute("aria-sort") === "ascending";
        all("th", table).forEach(th => th.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", falling ? "descending" : "ascending");
        const rows = all("tr:not(.total)", body).map(row => [row, row.cells[column].textContent.trim()]);
        const numeric = rows.some(([, text]) => !isNaN(parsed(text))) && !head.classList.contains("text");
        const order = ([, a], [, b]) => numeric
          ? (isNaN(parsed(a)) - isNaN(parsed(b)) || parsed(a) - parsed(b))
          : a.localeCompare(b, undefined, {numeric: true});
        rows.sort((a, b) => falling ? order(b, a) : order(a, b));
        body.prepend(...rows.map(([row]) => row));
      };
    });
  }

  function filterable(table) {
    const rows = all("tbody tr:not(.total)", table);
    const form = made("form", {className: "filter", onsubmit: () => false});
    const tests = all("thead th", table).flatMap((head, column) => {
      const name = head.textContent, cell = row => row.cells[column].textContent.trim();
      const label = made("label", {textContent: `${name} `});
      if (head.dataset.filter === "choose") {
        const select = made("select");
        select.append(made("option", {value: "", textContent: "all"}));
        new Set(rows.map(cell)).forEach(value => select.append(made("option", {value, textContent: value})));
        label.append(select);
        form.append(label);
        return [row => !select.value || cell(row) === select.value];
      }
      if (head.dataset.filter === "least") {
        const least = made("input", {type: "number", step: "any", min: 0});
        label.append("at least ", least);
        form.append(label);
        return [row => !least.value || parsed(cell(row)) >= least.valueAsNumber];
      }
      return [];
    });
    const search = made("input", {type: "search"});
    const label = made("label", {textContent: "search "});
    label.append(search);
    const count = made("output");
    form.append(label, count);
    form.oninput = () => {
      const wanted = search.value.trim().toLowerCase();
      rows.forEach(row => {
        row.hidden = !tests.every(test => test(row)) || !row.textContent.toLowerCase().includes(wanted);
        const link = row.querySelector("a[href^='#']");
        const figure = link && document.querySelector(link.getAttribute("href"));
        if (figure) figure.hidden = row.hidden;
      });
      count.textContent = `${rows.filter(row => !row.hidden).length} of ${rows.length}`;
    };
    form.oninput();
    table.parentElement.before(form);
  }

  // Two ticked sessions: the command that compares them, and the columns in which they differ.
  function comparable(place) {
    const ticks = all("[data-session]").map(name => {
      const tick = made("input", {type: "checkbox", title: "Compare"});
      tick.setAttribute("aria-label", `compare ${name.textContent}`);
      name.closest("td").prepend(tick, " ");
      return Object.assign(tick, {session: name.dataset.session});
    });
    const quoted = text => /^[\w./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
    ticks.forEach(tick => tick.onchange = () => {
      const two = ticks.filter(one => one.checked);
      ticks.forEach(one => { one.disabled = two.length === 2 && !one.checked; });
      place.hidden = two.length !== 2;
      if (place.hidden) return;
      const [a, b] = two.map(one => [...one.closest("tr").cells].map(cell => cell.textContent.trim()));
      const heads = all("thead th", two[0].closest("table")).map(head => head.textContent);
      const parts = heads.flatMap((head, n) => n > 0 && a[n] !== b[n] ? [`${head}: ${a[n] || "-"} | ${b[n] || "-"}`] : []);
      const command = made("code", {textContent: `rig compare ${two.map(one => quoted(one.session)).join(" ")}`});
      place.replaceChildren(`${a[0]} | ${b[0]}: ${parts.join("; ") || "no difference in this table"}. `, command);
    });
  }

  all("table.explored").forEach(table => { filterable(table); sortable(table); });
  all("#compared").forEach(comparable);

  // --- figures over all lifts: values near the pointer, zoom, a click on a point opens its lift --------------
  const NEAR_PX = 40;

  function shapes(u, data) {
    const {ctx, bbox} = u, unit = devicePixelRatio;
    const place = ([x, y]) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
    data.shapes.filter(one => !one.text).forEach(one => {
      const points = one.at.map(place);
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      ctx.globalAlpha = one.alpha;
      ctx.strokeStyle = colour(one.stroke);
      ctx.fillStyle = colour(one.fill || one.stroke);
      if (one.fill || one.width) {
        ctx.beginPath();
        points.forEach(([x, y]) => ctx.lineTo(x, y));
        ctx.lineWidth = (one.width || 0) * unit;
        ctx.setLineDash(one.dash ? [6 * unit, 4 * unit] : []);
        if (one.fill) ctx.fill(); else ctx.stroke();
      }
      if (one.dot) points.forEach(([x, y]) => { ctx.beginPath(); symbol(ctx, one, x, y, one.dot * unit / 2); });
      ctx.restore();
    });
    ctx.save();
    ctx.font = `${12 * unit}px sans-serif`;
    data.shapes.filter(one => one.text).forEach(one => {
      const [x, y] = place(one.at[0]);
      if (x < bbox.left - 1 || x > bbox.left + bbox.width + 1) return;
      ctx.fillStyle = colour(one.fill);
      ctx.textAlign = one.align;
      ctx.fillText(one.text, x, Math.max(y, bbox.top) - 3 * unit);
    });
    ctx.restore();
  }

  function symbol(ctx, {marker}, x, y, half) {
    const corners = {s: 4, D: 4, "^": 3, "|": 2, x: 4}[marker];
    if (!corners) return ctx.arc(x, y, half, 0, 7), ctx.fill();
    const first = {s: 0.785, D: 0, "^": -1.571, "|": 1.571, x: 0.785}[marker];
    const at = [...Array(corners).keys()].map(i => first + 6.283 * i / corners)
      .map(angle => [x + 1.3 * half * Math.cos(angle), y + 1.3 * half * Math.sin(angle)]);
    if (marker === "x") at.splice(1, 3, at[2], at[1], at[3]);
    if (!"|x".includes(marker)) { at.forEach(corner => ctx.lineTo(...corner)); ctx.fill(); return; }
    for (let i = 0; i < at.length; i += 2) { ctx.moveTo(...at[i]); ctx.lineTo(...at[i + 1]); }
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.stroke();
  }

  function keyed(entries) {
    const list = made("ul", {className: "key"});
    entries.forEach(entry => {
      const item = made("li"), sign = made("i", {className: entry.width ? (entry.dash ? "dash" : "line") : "fill"});
      sign.style[entry.width ? "borderColor" : "background"] = `var(--${entry.stroke})`;
      item.append(sign, entry.label);
      list.append(item);
    });
    return list;
  }

  function plottedAgain(figure) {
    const data = JSON.parse(figure.querySelector("script.plot").textContent);
    const place = made("div", {className: "plotted"}), about = made("output", {className: "near"});
    const view = {}, whole = () => ["x", "y"].forEach(name => { view[name] = data[name].limits; });
    let u = null, near = null, pressed = null;
    const label = made("p", {className: "small across", textContent: data.x.label});  // wraps on a phone
    figure.querySelector("svg").after(...(data.key.length ? [keyed(data.key)] : []), place, label);
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", figure.querySelector("svg").getAttribute("aria-label"));

    function dates(u, times, axis, space, apart) {  // in UTC; apart: s between two
      const [from, to] = apart < 86400 ? [5, 16] : [0, 10];
      return times.map(time => new Date(1000 * time).toISOString().slice(from, to).replace("T", " "));
    }

    function axis({label, ticks, date}, name) {
      const font = "12px sans-serif";
      const widest = (u, texts) => {
        u.ctx.font = font;
        return 12 + Math.max(0, ...(texts || []).flatMap(text => `${text}`.split("\n")).map(text => u.ctx.measureText(text).width));
      };
      return {...(name === "y" && {label, labelSize: 20, labelFont: font}), font, stroke: colour("ink"), ticks: {show: false},
        grid: {stroke: colour("line"), width: 1, show: !ticks}, size: name === "y" ? widest : 30, values: ticked,
        ...(date && {values: dates, space: 90}), ...(ticks && {splits: () => ticks.map(([at]) => at), values: () => ticks.map(([, text]) => text)})};
    }

    function scale({date, down}, name) {
      return {time: date, dir: down ? -1 : 1, range: () => view[name]};
    }

    function zoomed(u) {
      const {left, top, width, height} = u.select;
      [["x", left, left + width], ["y", top, top + height]].forEach(([name, from, to]) => {
        view[name] = [u.posToVal(from, name), u.posToVal(to, name)].sort((a, b) => a - b);
      });
      u.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
      u.setData(u.data);
    }

    function nearest(u) {
      const {left, top} = u.cursor;
      const away = ([x, y]) => Math.hypot(u.valToPos(x, "x") - left, u.valToPos(y, "y") - top);
      const found = data.spots.reduce((best, spot) => away(spot) < away(best) ? spot : best);
      near = left >= 0 && away(found) < NEAR_PX ? found : null;
      about.hidden = !near;
      u.over.style.cursor = near && near[3] ? "pointer" : "crosshair";
      if (!near) return;
      const [x, y] = [u.valToPos(near[0], "x"), u.valToPos(near[1], "y")], {clientWidth, clientHeight} = u.over;
      about.textContent = near[2];
      about.style.cssText = (x < clientWidth / 2 ? `left: ${x + 12}px;` : `right: ${clientWidth - x + 12}px;`)
        + (y < clientHeight / 2 ? `top: ${Math.max(y, 0) + 12}px` : `bottom: ${clientHeight - y + 12}px`);
    }

    function draw() {
      if (u) u.destroy();
      const width = Math.min(place.clientWidth, 460);
      u = new uPlot({
        tzDate: time => uPlot.tzDate(new Date(1000 * time), "Etc/UTC"),
        width, height: Math.round(width / data.aspect) - 20, legend: {show: false},
        series: [{}, {show: true, stroke: "transparent", points: {show: false}}],
        scales: {x: scale(data.x, "x"), y: scale(data.y, "y")}, axes: [axis(data.x, "x"), axis(data.y, "y")],
        padding: [18, data.x.date ? 32 : 12, 0, 0], cursor: {x: false, y: false, drag: {x: true, y: true, uni: 30, setScale: false}, points: {show: false}},
        hooks: {draw: [u => shapes(u, data)], setCursor: [nearest], setSelect: [zoomed]},
      }, [data.x.limits, data.y.limits], place);
      u.over.append(about);
      about.hidden = true;
      u.over.addEventListener("dblclick", () => { whole(); u.setData(u.data); });
      u.over.addEventListener("mousedown", event => { pressed = [event.clientX, event.clientY]; });
      u.over.addEventListener("click", event => {
        const moved = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
        if (near && near[3] && moved < 3) location.hash = near[3];
      });
    }

    whole();
    draw();
    new ResizeObserver(() => { if (Math.min(place.clientWidth, 460) !== u.width) draw(); }).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  }

  all("figure:has(script.plot)").forEach(plottedAgain);

  // --- one lift -----------------------------------------------------------------------------------------
  const place = document.getElementById("explorer");
  const lifts = all(".thumbs figure").filter(figure => document.getElementById(`${figure.id}-data`));
  if (!place || !lifts.length) return;
  const part = selector => place.querySelector(selector);
  const screen = part(".screen"), scrubber = part("input"), play = part(".play"), said = part("output");
  let shown = null, lift = null, plots = [], timer = 0;

  function phases(u) {
    const left = u.bbox.left, right = left + u.bbox.width, names = lift.phases.filter(([name]) => name);
    u.ctx.save();
    u.ctx.font = `${12 * devicePixelRatio}px sans-serif`;
    names.forEach(([name, begins], i) => {
      const x = time => Math.min(Math.max(u.valToPos(time, "x", true), left), right);
      const from = x(begins), to = i + 1 < names.length ? x(names[i + 1][1]) : right;
      if (name === "B") {
        u.ctx.fillStyle = colour("phase");
        u.ctx.fillRect(from, u.bbox.top, to - from, u.bbox.height);
      }
      u.ctx.fillStyle = colour("muted");
      if (u === plots[0] && "ABC".includes(name) && to > from) {
        u.ctx.fillText(name, (from + to) / 2 - 4, u.bbox.top - 4);
      }
    });
    lift.marks.forEach(([name, time]) => {
      u.ctx.fillStyle = colour(name);
      const x = u.valToPos(time, "x", true);
      if (x >= left && x <= right) u.ctx.fillRect(x, u.bbox.top, devicePixelRatio, u.bbox.height);
    });
    u.ctx.restore();
  }

  function plotted(panel, last) {
    const series = [{label: "time, s", value: (u, v) => v == null ? "" : number(v, 3)}], bands = [];
    const tables = panel.series.map(of => {
      const [times, values, half] = of.table, stroke = colour(of.colour);
      series.push({label: of.label, stroke, width: of.width, dash: of.dash || [], points: {show: false},
        value: (u, v) => v == null ? "" : number(v, 2)});
      if (!half) return of.table;
      bands.push({series: [series.length + 1, series.length], fill: `${stroke}38`});
      const unseen = {stroke: "transparent", points: {show: false}, class: "unseen"};
      series.push({...unseen}, {...unseen});
      const edge = side => values.map((v, i) => v == null ? null : v + side * half[i]);
      return [times, values, edge(-1), edge(1)];
    });
    const axis = {stroke: colour("ink"), grid: {stroke: colour("line"), width: 1}, ticks: {show: false}, values: ticked};
    const u = new uPlot({
      width: part(".plots").clientWidth, height: (last ? 40 : 24) + panel.height, series, bands,
      scales: {x: {time: false, range: (u, low, high) => [low, high]}, ...(panel.limits && {y: {range: panel.limits}})},
      axes: [{...axis, show: last, size: 30}, {...axis, label: panel.label, labelSize: 18, size: 42}],
      padding: [18, 8, last ? 0 : 6, 0],
      cursor: {y: false, sync: {key: "lift", scales: ["x", null]}, drag: {x: true, y: false}, points: {size: 6}},
      hooks: {drawClear: [phases], setCursor: [u => { if (u === plots[0]) follow(u); }]},
    }, uPlot.join([[lift.range], ...tables]), part(".plots"));
    return u;
  }

  function follow(u) {
    if (u.cursor.left >= 0) filmed(u.posToVal(u.cursor.left, "x"));
  }

  function filmed(time) {
    scrubber.value = time;
    said.textContent = number(time, 2, " s");
    const film = lift.film;
    if (!film) return;
    let frame = film.times.findIndex(t => t > time);
    frame = frame < 0 ? film.times.length - 1 : Math.max(frame - 1, 0);
    screen.style.backgroundPositionY = `${100 * frame / Math.max(film.times.length - 1, 1)}%`;
  }

  function moveTo(time) {
    plots.forEach(u => u.setCursor({left: u.valToPos(time, "x"), top: u.over.clientHeight / 2}));
    filmed(time);
  }

  function show(figure) {
    clearInterval(timer);
    shown = figure;
    lift = JSON.parse(document.getElementById(`${figure.id}-data`).textContent);
    place.hidden = false;
    part("h3").textContent = figure.querySelector("h3").textContent;
    part(".about").textContent = figure.querySelector("figcaption").textContent;
    lifts.forEach(each => each.classList.toggle("current", each === figure));
    const film = lift.film;
    all(".film", place).forEach(each => { each.hidden = !film; });
    if (film) {
      screen.style.aspectRatio = film.size.join("/");
      screen.style.backgroundImage = `url(${film.sheet})`;
      screen.style.backgroundSize = `100% ${100 * film.times.length}%`;
      screen.setAttribute("aria-label", film.label);
      part(".names").textContent = `From left to right: ${film.label}. ${film.about}`;
    }
    [scrubber.min, scrubber.max] = lift.range;
    draw();
    const start = Math.min(Math.max(0, lift.range[0]), lift.range[1]);
    filmed(start);
    setTimeout(() => moveTo(start));  // the plots are laid out after this turn of the event loop
  }

  function draw() {
    plots.forEach(u => u.destroy());
    plots = [];
    lift.panels.forEach((panel, i) => plots.push(plotted(panel, i === lift.panels.length - 1)));
  }

  const named = () => lifts.find(figure => `#${figure.id}` === location.hash);
  const step = by => {
    const seen = lifts.filter(figure => !figure.hidden), at = seen.indexOf(shown);
    if (seen.length) location.hash = seen[(at + by + seen.length) % seen.length].id;
  };
  addEventListener("hashchange", () => {
    const figure = named();
    if (figure) { show(figure); place.scrollIntoView({block: "start"}); }
  });
  lifts.forEach(figure => figure.addEventListener("click", () => { location.hash = figure.id; }));
  all("[data-step]", place).forEach(button => { button.onclick = () => step(+button.dataset.step); });
  scrubber.oninput = () => moveTo(scrubber.valueAsNumber);
  play.onclick = () => {
    clearInterval(timer);
    let time = scrubber.valueAsNumber >= +scrubber.max - 0.05 ? +scrubber.min : scrubber.valueAsNumber;
    timer = setInterval(() => {
      moveTo(time += 0.05);
      if (time >= +scrubber.max) clearInterval(timer);
    }, 50);
  };
  new ResizeObserver(() => plots.forEach(u => u.setSize({width: part(".plots").clientWidth, height: u.height})))
    .observe(part(".plots"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (lift) draw(); });
  const first = named();
  show(first || lifts[0]);
  if (first) addEventListener("load", () => setTimeout(() => place.scrollIntoView({block: "start"})));
})();
