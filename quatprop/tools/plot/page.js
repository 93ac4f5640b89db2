// Zoom, pan and values of the picture of a page, which without this script stands as it was drawn.
// The paths of the picture are the data: they are rewritten to zoom, and values are read from them.
const figure = document.querySelector("figure"), svg = figure.querySelector("svg");
const limits = JSON.parse(figure.dataset.limits), signed = text => text.replace("-", "\u2212");
const number = (node, name) => Number(node.getAttribute(name));
const make = (name, attributes) => {
  const element = svg.appendChild(document.createElementNS(svg.namespaceURI, name));
  for (const key in attributes) element.setAttribute(key, attributes[key]);
  return element;
};
const panels = [...svg.querySelectorAll("g[id^=axes_]")].map((group, place) => {
  const all = selector => [...group.querySelectorAll(`:scope > ${selector}`)];
  const {x, y, width, height} = group.querySelector("path").getBBox();
  const [low, high, log, unit] = limits.panels[place];
  return {
    top: y, bottom: y + height, left: x, right: x + width, low, high, log, unit, copies: [],
    ticks: ["x", "y"].map(axis => all(`g > [id^=${axis}tick_]`)),
    paths: all(":is([id^=line2d], [id^=curve]) > path, :scope > [id*=Collection] path").map(node => {
      // Areas are drawn from the lower edge of the picture.
      const offset = node.closest("defs") ? svg.viewBox.baseVal.height : 0;
      return {node, offset, drawn: node.getAttribute("d") ?? ""};
    }),
    marks: all("[id^=line2d] use").map(node => ({node, x: number(node, "x"), y: number(node, "y")})),
    curves: all("[id^=curve] > path").map(node => ({
      colour: node.style.stroke,
      points: [...(node.getAttribute("d") ?? "").matchAll(/([ML]) (\S+) (\S+)/g)]
        .map(([, how, x, y]) => ({x: Number(x), y: Number(y), joined: how === "L"})),
    })),
    values: make("text", {x: x + width, y: y - 2}),
  };
});
const {left, right, top} = panels[0], {bottom} = panels.at(-1), width = right - left;
const cursor = make("path", {class: "cursor"});
const range = make("rect", {class: "range", y: top, height: bottom - top});
const clock = make("text", {x: right, y: bottom + 26});
const time = x => limits.time[0] + (limits.time[1] - limits.time[0]) * (x - left) / width;
const decimals_of = step => Math.min(Math.max(0, Math.ceil(-Math.log10(step) - 1e-9)), 12);
// What was drawn of a long series are the extremes of short times: nothing is known within those.
const least = Math.max(limits.least / (limits.time[1] - limits.time[0]) * width, 0.5);
let from = left, to = right, pressed = null;

// Draw ticks of a panel along x (0) or y (1) for values from low to high, at places start to end.
function draw_ticks({copies, ticks}, along, low, high, start, end) {
  const [original] = ticks[along];
  if (!original) return;
  const rough = (high - low) / Math.max(Math.abs(end - start) / [50, 18][along], 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
  const decimals = decimals_of(step), largest = Math.max(Math.abs(low), Math.abs(high));
  const exponent = Math.floor(Math.log10(largest)), is_long = largest >= 1e5 || largest < 1e-2;
  for (let count = Math.ceil(low / step); count * step <= high; count += 1) {
    const place = start + (end - start) * (count * step - low) / (high - low);
    const shift = place - number(original.querySelector("use"), "xy"[along]);
    const copy = original.cloneNode(true), label = copy.querySelector("text");
    copy.style.display = "";
    copy.setAttribute("transform", along ? `translate(0 ${shift})` : `translate(${shift} 0)`);
    copy.querySelector("[clip-path]").removeAttribute("clip-path");
    const text = is_long && count ? (count * step).toExponential(decimals_of(step / 10 ** exponent))
      : (count * step).toFixed(is_long ? 0 : decimals);
    if (label) label.textContent = signed(text.replace("e+", "e"));
    copies.push(original.parentNode.appendChild(copy));
  }
}

// Show the part of the picture as it was drawn that lies between two places.
function show(start, end) {
  const span = Math.min(Math.max(end - start, least), width), whole = span === width;
  from = Math.min(Math.max((start + end - span) / 2, left), right - span);
  to = from + span;
  for (const panel of panels) {
    const {top, bottom, low, high, log} = panel;
    const seen = panel.curves.flatMap(({points}) => points.filter((point, place) =>
      (points[place + 1] ?? point).x >= from && (points[place - 1] ?? point).x <= to));
    let [highest, lowest] = [top, bottom];
    if (!whole && !log && seen.length) {
      const ys = seen.map(({y}) => y).sort((a, b) => a - b);
      const margin = Math.max(0.1 * (ys.at(-1) - ys[0]), 0.3);
      [highest, lowest] = [Math.max(top, ys[0] - margin), Math.min(bottom, ys.at(-1) + margin)];
    }
    const x_of = x => left + (x - from) / span * width;
    const y_of = y => top + (y - highest) / (lowest - highest) * (bottom - top);
    for (const {node, offset, drawn} of panel.paths) {
      node.setAttribute("d", drawn.replace(/(-?[\d.]+) (-?[\d.]+)/g, (_, x, y) =>
        `${x_of(Number(x))} ${y_of(Number(y) + offset) - offset}`));
    }
    for (const {node, x, y} of panel.marks) {
      node.setAttribute("x", x_of(x));
      node.setAttribute("y", y_of(y));
      node.style.display = x < from || x > to || y < highest || y > lowest ? "none" : "";
    }
    for (const copy of panel.copies.splice(0)) copy.remove();
    panel.ticks.forEach((ticks, along) => ticks.forEach(tick => {
      tick.style.display = whole || (along && log) ? "" : "none";
    }));
    if (whole) continue;
    const value = y => low + (high - low) * (bottom - y) / (bottom - top);
    draw_ticks(panel, 0, time(from), time(to), left, right);
    if (!log) draw_ticks(panel, 1, value(lowest), value(highest), bottom, top);
  }
}

// Write the time at a place, and the values of the lines there.
function read(x) {
  const inside = x >= left && x <= right, at = from + (to - from) * (x - left) / width;
  const text = time(at).toFixed(decimals_of((time(to) - time(from)) / 1000));
  clock.textContent = inside ? `${signed(text)} s` : "";
  cursor.setAttribute("d", inside ? panels.map(panel => `M ${x} ${panel.top} V ${panel.bottom}`).join(" ") : "");
  for (const {values, curves, top, bottom, low, high, log, unit} of panels) {
    values.replaceChildren();
    for (const {colour, points} of inside ? curves : []) {
      const before = points.findLastIndex(point => point.x <= at);
      const [a, b] = before < 0 ? [] : points.slice(before, before + 2);
      let y = a && at - a.x < 0.5 ? a.y : NaN;
      if (b?.joined) y = a.y + (b.y - a.y) * (at - a.x) / (b.x - a.x);
      const value = low + (high - low) * (bottom - y) / (bottom - top);
      const part = make("tspan", {fill: colour, dx: values.firstChild ? 6 : 0});
      const digits = log ? (10 ** value).toPrecision(4) : value.toFixed(decimals_of((high - low) / 5e4));
      part.textContent = isNaN(y) ? "\u2013" : signed(`${Number(digits)}`);
      values.append(part);
    }
    if (values.firstChild && unit) values.append(` ${unit}`);
  }
}

const place_of = event => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse()).x;
const dragged = x => [Math.min(pressed.x, x), Math.max(pressed.x, x)].map(end => Math.min(Math.max(end, left), right));
svg.addEventListener("pointerdown", event => {
  pressed = {x: place_of(event), from, to};
  svg.setPointerCapture(event.pointerId);
});
svg.addEventListener("pointermove", event => {
  const x = place_of(event);
  if (pressed && event.shiftKey) {
    const shift = (pressed.x - x) / width * (to - from);
    show(pressed.from + shift, pressed.to + shift);
  } else if (pressed) {
    const [start, end] = dragged(x);
    range.setAttribute("x", start);
    range.setAttribute("width", end - start);
  }
  read(x);
});
svg.addEventListener("pointerup", event => {
  const [start, end] = dragged(place_of(event)).map(x => from + (to - from) * (x - left) / width);
  if (range.getAttribute("width") > 4 && !event.shiftKey) show(start, end);
  range.setAttribute("width", 0);
  pressed = null;
});
svg.addEventListener("pointerleave", () => read(NaN));
svg.addEventListener("dblclick", () => show(left, right));
figure.addEventListener("keydown", event => {
  const steps = {ArrowLeft: [-0.1, -0.1], ArrowRight: [0.1, 0.1], "+": [0.2, -0.2], "-": [-0.3, 0.3], Escape: [-1e9, 1e9]};
  const step = !event.ctrlKey && !event.metaKey && steps[event.key];
  if (!step) return;
  show(from + step[0] * (to - from), to + step[1] * (to - from));
  event.preventDefault();
});
document.querySelector(".hint").hidden = false;
