// Canvases: axes with their numbers, curves, the phase plane, eigenvalues, the road from above. Units are the screen's.
const FONT = "12px system-ui, sans-serif";

// The canvas in the pixels of this screen, empty, and the colours of the page.
export function blank(canvas) {
  const { width, height } = canvas.getBoundingClientRect(), dense = window.devicePixelRatio || 1;
  canvas.width = Math.round(width * dense);
  canvas.height = Math.round(height * dense);
  const pen = canvas.getContext("2d");
  pen.setTransform(dense, 0, 0, dense, 0, 0);
  pen.font = FONT;
  const style = getComputedStyle(document.documentElement), known = {};
  return { pen, width, height, color: (name) => (known[name] ??= style.getPropertyValue(`--${name}`).trim()) };
}

const STEPS = [1, 2, 5, 10];
export function ticks(least, most, count) {
  const rough = (most - least) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = STEPS.find((one) => one * power >= rough * 0.6) * power;
  const found = [];
  for (let k = Math.ceil(least / step - 1e-9); k * step <= most + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
}

// Axes from `least` to `most` in x and y; gives the functions that place a value, and those that read a pixel. `words`:
// of both axes, a title, ticks [[value, text], ...] where they are not the usual ones, what is drawn `behind`.
export function axes(canvas, x, y, words) {
  const { pen, width, height, color } = blank(canvas);
  const box = { left: 54, right: width - 10, top: words.title ? 22 : 10, bottom: height - 34 };
  const px = (value) => box.left + ((value - x[0]) / (x[1] - x[0])) * (box.right - box.left);
  const py = (value) => box.bottom - ((value - y[0]) / (y[1] - y[0])) * (box.bottom - box.top);
  pen.lineWidth = 1;
  pen.fillStyle = color("soft");
  const stroke = (kind, x0, y0, x1, y1) => {
    pen.strokeStyle = color(kind);
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  };
  words.behind?.({ pen, px, py, box, color });
  pen.fillStyle = color("soft");
  pen.textAlign = "center";
  pen.textBaseline = "top";
  const marks = (given, range, count) => given ?? ticks(...range, count).map((value) => [value, label(value)]);
  for (const [value, text] of marks(words.xTicks, x, Math.max(3, (box.right - box.left) / 80))) {
    stroke(value === 0 && !words.xTicks ? "soft" : "grid", px(value), box.top, px(value), box.bottom);
    pen.fillText(text, px(value), box.bottom + 4);
  }
  pen.fillText(words.x, (box.left + box.right) / 2, box.bottom + 18);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  for (const [value, text] of marks(words.yTicks, y, Math.max(3, (box.bottom - box.top) / 45))) {
    stroke(value === 0 && !words.yTicks ? "soft" : "grid", box.left, py(value), box.right, py(value));
    pen.fillText(text, box.left - 5, py(value));
  }
  pen.textAlign = "left";
  if (words.title) {
    pen.fillStyle = color("ink");
    pen.fillText(words.title, box.left, 11);
  }
  if (words.y) {
    pen.save();
    pen.translate(9, (box.top + box.bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textAlign = "center";
    pen.fillText(words.y, 0, 0);
    pen.restore();
  }
  const within = (draw) => {
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    pen.clip();
    draw();
    pen.restore();
  };
  const read = (px0, py0) => [
    x[0] + ((px0 - box.left) / (box.right - box.left)) * (x[1] - x[0]),
    y[0] + ((box.bottom - py0) / (box.bottom - box.top)) * (y[1] - y[0]),
  ];
  return { pen, px, py, box, color, within, read };
}

// Powers of ten from one logarithm to another, with what lies between two where there is room.
export function decades(least, most) {
  const found = [], between = most - least < 1.7 ? [1, 2, 5] : [1];
  for (let power = Math.floor(least); power <= most; power++) {
    for (const digit of between) {
      const value = power + Math.log10(digit);
      if (value >= least - 1e-9 && value <= most + 1e-9) found.push([value, label(Number((digit * 10 ** power).toPrecision(3)))]);
    }
  }
  return found;
}

const label = (value) => String(value).replace("-", "−");

export function curve(plot, xs, ys, name, width = 2, dashes = []) {
  const { pen } = plot;
  pen.strokeStyle = plot.color(name);
  pen.lineWidth = width;
  pen.setLineDash(dashes);
  pen.beginPath();
  xs.forEach((x, k) => (k ? pen.lineTo(plot.px(x), plot.py(ys[k])) : pen.moveTo(plot.px(x), plot.py(ys[k]))));
  pen.stroke();
  pen.setLineDash([]);
}

export function dot(plot, x, y, name, radius, filled = true) {
  const { pen } = plot;
  pen.beginPath();
  pen.arc(plot.px(x), plot.py(y), radius, 0, 2 * Math.PI);
  pen.lineWidth = 2;
  pen.fillStyle = pen.strokeStyle = plot.color(name);
  if (filled) pen.fill();
  else pen.stroke();
}

export function cross(plot, x, y, name) {
  const { pen } = plot, r = 8, cx = plot.px(x), cy = plot.py(y);
  pen.strokeStyle = plot.color(name);
  pen.lineWidth = 3.5;
  pen.beginPath();
  for (const s of [1, -1]) {
    pen.moveTo(cx - r, cy - s * r);
    pen.lineTo(cx + r, cy + s * r);
  }
  pen.stroke();
}

// A saddle: two ways in, two ways out.
export function diamond(plot, x, y, name, radius) {
  const { pen } = plot, cx = plot.px(x), cy = plot.py(y);
  pen.beginPath();
  for (const [dx, dy] of [[0, -1], [1, 0], [0, 1], [-1, 0]]) pen.lineTo(cx + dx * radius, cy + dy * radius);
  pen.closePath();
  pen.lineWidth = 2.5;
  pen.fillStyle = plot.color("panel");
  pen.strokeStyle = plot.color(name);
  pen.fill();
  pen.stroke();
}

// Cells of a grid from -x to x and -y to y, rows in hexadecimal from the bottom, filled where a bit of their row is set.
export function cells(plot, [x, y], nodes, rows, name) {
  const { pen } = plot, wide = (2 * x) / (nodes - 1), tall = (2 * y) / (nodes - 1);
  const height = Math.abs(plot.py(tall) - plot.py(0)) + 0.5;
  pen.fillStyle = plot.color(name);
  rows.forEach((digits, row) => {
    const bits = BigInt(`0x${digits}`).toString(2).padStart(nodes, "0");
    const top = plot.py(-y + (row + 0.5) * tall);
    for (let from = bits.indexOf("1"); from >= 0; ) {
      const next = bits.indexOf("0", from), to = next < 0 ? nodes : next;
      const left = plot.px(-x + (from - 0.5) * wide), right = plot.px(-x + (to - 0.5) * wide);
      pen.fillRect(left, top, right - left, height);
      from = bits.indexOf("1", to);
    }
  });
}

// A part of the plot from one x to another.
export function band(plot, from, to, name) {
  const { pen, box } = plot;
  pen.fillStyle = plot.color(name);
  pen.fillRect(plot.px(from), box.top, plot.px(to) - plot.px(from), box.bottom - box.top);
}

// Words at a point, so many pixels below it, and within the axes.
export function write(plot, x, y, below, words) {
  const { pen, box } = plot, half = pen.measureText(words).width / 2;
  pen.fillStyle = plot.color("ink");
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  const place = [Math.min(Math.max(plot.px(x), box.left + half), box.right - half), plot.py(y) + below];
  pen.strokeStyle = plot.color("panel");
  pen.lineWidth = 4;
  pen.lineJoin = "round";
  pen.strokeText(words, ...place); // what lies behind does not run through the letters
  pen.fillText(words, ...place);
}

// A small arrowhead at the middle of an orbit.
export function arrow(plot, points) {
  const k = Math.min(points.length - 1, 6);
  if (k < 1) return;
  const [x0, y0, x1, y1] = [plot.px(points[k - 1][0]), plot.py(points[k - 1][1]), plot.px(points[k][0]), plot.py(points[k][1])];
  const angle = Math.atan2(y1 - y0, x1 - x0);
  if (Math.hypot(x1 - x0, y1 - y0) < 0.3) return;
  const { pen } = plot;
  pen.fillStyle = pen.strokeStyle;
  pen.beginPath();
  pen.moveTo(x1, y1);
  for (const turn of [2.6, -2.6]) pen.lineTo(x1 + 7 * Math.cos(angle + turn), y1 + 7 * Math.sin(angle + turn));
  pen.fill();
}

export const indexAt = ({ time }, now) => Math.min(Math.round(now / (time[1] - time[0] || 1)), time.length - 1);

// One car above the other where it is now, and the way it came, in its lane or, where `halfWidth` is null, on a field;
// `gust`: what blows now, N to the left.
export function road(canvas, cars, now, halfWidth, gust) {
  const { pen, width, height, color } = blank(canvas);
  const each = height / cars.length, scale = Math.min((each - 22) / (halfWidth === null ? 16 : 2 * halfWidth + 6.5), 20);
  cars.forEach((one, row) => {
    const { columns } = one, k = columns ? indexAt(columns, now) : 0;
    const at = columns?.longitudinal_position[k] ?? 0, middle = each * row + 22 + (each - 22) / 2;
    const aside = halfWidth === null ? columns?.lateral_position[k] ?? 0 : 0; // the field moves, the car stays in view
    const px = (x) => width * 0.6 + (x - at) * scale, py = (y) => middle - (y - aside) * scale;
    pen.save();
    pen.beginPath();
    pen.rect(0, each * row + 22, width, each - 22);
    pen.clip();
    pen.fillStyle = color("road");
    if (halfWidth === null) {
      pen.fillRect(0, each * row + 22, width, each - 22);
      squares(pen, { width, px, py, at, aside, scale, top: each * row + 22, bottom: each * (row + 1) }, color);
    } else lane(pen, { width, px, py, at, scale, halfWidth }, color);
    if (columns) {
      const way = { pen, px, py, color }, y = columns.lateral_position[k];
      curve(way, columns.longitudinal_position.slice(0, k + 1), columns.lateral_position.slice(0, k + 1), one.color, 2, one.dashes);
      body(pen, px(at), py(y), scale, columns, k, one.car, color(one.color), color("ink"));
      if (gust) wind(pen, px(at), py(y), scale, gust > 0 ? -1 : 1, color("ink"));
    }
    pen.restore();
    pen.fillStyle = color("ink");
    pen.textAlign = "left";
    pen.textBaseline = "top";
    const isLast = columns && k === columns.time.length - 1;
    const end = isLast || !columns ? `: ${one.ending}` : "", squared = halfWidth === null ? " (squares of 5 m)" : "";
    const fitting = [one.who, one.shortly].map((who) => `Car ${one.letter}, ${who}${end}${squared}`);
    pen.fillText(fitting.find((words) => pen.measureText(words).width < width - 8) ?? fitting[1], 4, each * row + 4, width - 8);
  });
}

function lane(pen, { width, px, py, at, scale, halfWidth }, color) {
  pen.fillRect(0, py(halfWidth), width, 2 * halfWidth * scale);
  pen.lineWidth = 2;
  pen.strokeStyle = color("soft");
  pen.beginPath();
  for (const side of [halfWidth, -halfWidth]) {
    pen.moveTo(0, py(side));
    pen.lineTo(width, py(side));
  }
  pen.stroke();
  pen.lineWidth = 1;
  pen.setLineDash([3 * scale, 6 * scale]);
  pen.lineDashOffset = ((at - (0.6 * width) / scale) * scale) % (9 * scale);
  pen.beginPath();
  pen.moveTo(0, py(0));
  pen.lineTo(width, py(0));
  pen.stroke();
  pen.setLineDash([]);
  pen.lineDashOffset = 0;
}

// Lines every 5 m; the one on which the car began is thicker.
function squares(pen, { width, px, py, at, aside, scale, top, bottom }, color) {
  const each = 5, ahead = (0.4 * width) / scale, behind = (0.6 * width) / scale, half = (bottom - top) / (2 * scale);
  pen.strokeStyle = color("soft");
  const line = (thick, x0, y0, x1, y1) => {
    pen.globalAlpha = thick ? 1 : 0.35;
    pen.lineWidth = thick ? 2 : 1;
    pen.beginPath();
    pen.moveTo(x0, y0);
    pen.lineTo(x1, y1);
    pen.stroke();
  };
  for (let x = each * Math.ceil((at - behind) / each); x <= at + ahead; x += each) line(false, px(x), top, px(x), bottom);
  for (let y = each * Math.ceil((aside - half) / each); y <= aside + half; y += each) line(y === 0, 0, py(y), width, py(y));
  pen.globalAlpha = 1;
}

// Three arrows that push the car; `down`: 1 to the bottom of the screen, -1 to its top.
function wind(pen, x, y, scale, down, ink) {
  pen.strokeStyle = ink;
  pen.lineWidth = 2.5;
  for (const aside of [-1, 0, 1]) {
    const tip = y - down * 1.2 * scale, tail = tip - down * 1.8 * scale, px = x + aside * 1.3 * scale;
    pen.beginPath();
    pen.moveTo(px, tail);
    pen.lineTo(px, tip);
    for (const side of [-4, 4]) {
      pen.moveTo(px, tip);
      pen.lineTo(px + side, tip - down * 7);
    }
    pen.stroke();
  }
}

function body(pen, x, y, scale, columns, k, car, color, ink) {
  pen.save();
  pen.translate(x, y);
  pen.rotate(-columns.heading[k]);
  pen.fillStyle = color;
  pen.globalAlpha = 0.85;
  pen.fillRect(-car.rear_extent * scale, (-car.body_width / 2) * scale, (car.front_extent + car.rear_extent) * scale, car.body_width * scale);
  pen.globalAlpha = 1;
  for (const [along, steer] of [[car.cg_to_front, columns.front_steer[k]], [-car.cg_to_rear, columns.rear_steer[k]]]) {
    for (const side of [-0.8, 0.8]) {
      pen.save();
      pen.translate(along * scale, (side * car.body_width * scale) / 2);
      pen.rotate(-steer);
      pen.fillStyle = ink;
      pen.fillRect(-0.33 * scale, -0.13 * scale, 0.66 * scale, 0.26 * scale);
      pen.restore();
    }
  }
  pen.restore();
}
