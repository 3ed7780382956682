// ---------------------------------------------------------------- charts

/** Round tick values within [low, high]. */
function ticks(low, high, count, whole = false) {
  const raw = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  let step = power * ([1, 2, 5].find((m) => m * power >= raw * 0.999) ?? 10);
  if (whole) step = Math.max(1, Math.round(step));
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  const values = [];
  for (let i = first; i <= last && values.length < 50; i++) values.push(i * step);
  const decimals = clamp(-Math.floor(Math.log10(step) + 1e-9), 0, 12);
  return { values, text: (v) => minus(Math.abs(v) < step / 2 ? (0).toFixed(decimals) : v.toFixed(decimals)) };
}

/** Power of ten (a multiple of three) to take out of numbers as large as `size`. */
function commonExponent(size) {
  if (!(size > 0)) return 0;
  const exponent = Math.floor(Math.log10(size));
  return exponent >= 5 || exponent <= -4 ? Math.max(-300, 3 * Math.floor(exponent / 3)) : 0;
}

/** Some room around the data, and an interval of positive length whatever they are. */
function padded(low, high) {
  if (low > high) return [-1, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  if (size === 0) return [-1, 1];
  if (high - low <= 1e-9 * size) return [low - 0.1 * size, high + 0.1 * size];
  return [low - 0.06 * (high - low), high + 0.06 * (high - low)];
}

/**
 * A line chart in a card.
 * spec: title, unit, x: { name, unit, whole }, series: [{ name, color, x, y, hold, wide }],
 * bounds: [{ name, color, values }], log, logChoice, synchronized, remark(i), zero, note, exact (small values are known too).
 * With `hold`, x are the edges of the blocks: one more than y.
 */
function lineChart(spec) {
  const sizeOf = (s) => s.y.reduce((m, v) => isNumber(v) ? Math.max(m, Math.abs(v)) : m, 0);
  const overall = spec.series.reduce((m, s) => Math.max(m, sizeOf(s)), 0);
  // A curve that is zero, or rounding beside the others, has nothing to show.
  const series = spec.series.filter((s) => s.y.some(isNumber) && (spec.log || spec.exact || (overall > 0 && sizeOf(s) > 1e-9 * overall)));
  if (!series.length) return null;
  const shownValue = (v) => spec.log || spec.exact ? format(v) : formatBeside(v, overall);
  const bounds = spec.bounds || [];
  const everyX = series.flatMap((s) => s.x).filter(isNumber);
  const banded = (s) => s.band && s.band.length ? s.y.flatMap((v, i) => [v - s.band[i], v + s.band[i]]) : s.y;
  const everyY = series.flatMap(banded).filter(isNumber);
  const xRange = everyX.reduce((m, v) => [Math.min(m[0], v), Math.max(m[1], v)], [Infinity, -Infinity]);
  const [x0, x1] = xRange[1] > xRange[0] ? xRange : [xRange[0] - 0.5, xRange[0] + 0.5];
  const largest = everyY.reduce((m, v) => Math.max(m, Math.abs(v)), 0);
  const shown = bounds.filter((b) => b.values.every((v) => largest === 0 || Math.abs(v) <= 6 * largest));
  const positive = everyY.filter((v) => v > 0);
  let log = Boolean(spec.log) && positive.length > 0;

  const plot = el('div', { class: 'plot' + (spec.synchronized ? ' seek' : '') });
  const at = el('span', { class: 'at num' });
  const legend = el('ul', { class: 'legend' });
  const values = series.map((s) => {
    const value = el('b', { class: 'num' });
    if (!s.thin) legend.append(el('li', {}, el('span', { class: s.dashed ? 'swatch dashed' : 'swatch', style: `border-color: ${s.color}` }), s.name, value));
    return value;
  });
  for (const b of bounds) legend.append(el('li', {},
    el('span', { class: 'swatch dashed', style: `border-color: ${b.color}` }), b.name, shown.includes(b) ? '' : ' (off the scale)'));
  const head = el('div', { class: 'head' }, el('h3', {}, spec.title, spec.unit ? el('span', {}, `  ${spec.unit}`) : ''));
  if (spec.logChoice && positive.length) {
    const button = el('button', { type: 'button', 'aria-pressed': String(log) }, 'log');
    button.setAttribute('aria-label', `Logarithmic scale for ${spec.title}`);
    button.addEventListener('click', () => { log = !log; button.setAttribute('aria-pressed', String(log)); render(); });
    head.append(button);
  }
  head.append(at);
  const card = el('div', { class: 'card chart' }, head, legend, plot);
  if (spec.note) card.append(el('p', { class: 'note' }, spec.note));

  function valueAt(s, x) {
    const i = indexAt(s.x, x);
    if (s.hold) return s.y[Math.min(i, s.y.length - 1)];
    if (spec.x.whole) return s.y[i];
    const j = Math.min(i + 1, s.y.length - 1), span = s.x[j] - s.x[i];
    if (!isNumber(s.y[i]) || !isNumber(s.y[j])) return s.y[i];
    return span > 0 ? s.y[i] + (s.y[j] - s.y[i]) * clamp((x - s.x[i]) / span, 0, 1) : s.y[i];
  }

  let scale = null, overlay = null, hover = null;

  function yAxis() {
    if (log) {
      const logs = positive.map(Math.log10);
      let low = Math.floor(Math.min(...logs) - 1e-9), high = Math.ceil(Math.max(...logs) + 1e-9);
      if (everyY.some((v) => v <= 0)) low -= 1;
      if (high - low < 1) high = low + 1;
      const stride = Math.max(1, Math.ceil((high - low) / 6));
      const values = [];
      for (let e = Math.ceil(low / stride) * stride; e <= high; e += stride) values.push(e);
      return { low, high, values, text: (e) => '10' + superscript(e), map: (v) => v > 0 ? Math.max(Math.log10(v), low) : low, factor: '' };
    }
    const candidates = everyY.concat(shown.flatMap((b) => b.values), spec.zero ? [0] : []);
    const exponent = commonExponent(candidates.reduce((m, v) => Math.max(m, Math.abs(v)), 0));
    const down = 10 ** -exponent;
    const map = (v) => v * down;
    const [least, most] = candidates.map(map).reduce((m, v) => [Math.min(m[0], v), Math.max(m[1], v)], [Infinity, -Infinity]);
    let [low, high] = padded(least, most);
    if (spec.zero && least === 0) low = 0;
    return { low, high, ...ticks(low, high, 6), map, factor: exponent ? `\u00d710${superscript(exponent)}` : '' };
  }

  function render() {
    const width = plot.clientWidth;
    if (!width) return;
    const y = yAxis();
    const labels = y.values.map(y.text);
    const left = 16 + 7.1 * Math.max(3, ...labels.map((t) => t.length)), right = 12, top = y.factor ? 20 : 8, bottom = 38;
    const height = 236 + top, w = Math.max(width - left - right, 40), h = height - top - bottom;
    const px = (x) => left + (x - x0) / (x1 - x0) * w;
    const py = (v) => top + h - (y.map(v) - y.low) / (y.high - y.low) * h;
    const f = (v) => v.toFixed(1);
    const xExponent = spec.x.whole ? 0 : commonExponent(Math.max(Math.abs(x0), Math.abs(x1)));
    const xDown = 10 ** -xExponent;
    const xTicks = ticks(x0 * xDown, x1 * xDown, clamp(w / 85, 2, 8), spec.x.whole);
    let svg = '';
    y.values.forEach((v, i) => {
      const row = top + h - (v - y.low) / (y.high - y.low) * h;
      svg += `<line x1="${left}" x2="${left + w}" y1="${f(row)}" y2="${f(row)}" stroke="var(--grid)"/>`
        + `<text x="${left - 8}" y="${f(row + 4)}" text-anchor="end">${labels[i]}</text>`;
    });
    for (const v of xTicks.values) {
      const column = px(v / xDown);
      svg += `<line x1="${f(column)}" x2="${f(column)}" y1="${top + h}" y2="${top + h + 4}" stroke="var(--soft)"/>`
        + `<text x="${f(column)}" y="${top + h + 17}" text-anchor="middle">${xTicks.text(v)}</text>`;
    }
    if (y.factor) svg += `<text x="${left}" y="12">${y.factor}</text>`;
    const xName = spec.x.name + (spec.x.unit ? ` (${xExponent ? `10${superscript(xExponent)} ` : ''}${spec.x.unit})` : '');
    svg += `<text x="${f(left + w)}" y="${top + h + 33}" text-anchor="end">${xName}</text>`
      + `<line x1="${left}" x2="${left + w}" y1="${top + h}" y2="${top + h}" stroke="var(--soft)"/>`;
    for (const b of shown) for (const v of b.values)
      svg += `<line x1="${left}" x2="${left + w}" y1="${f(py(v))}" y2="${f(py(v))}" stroke="${b.color}" stroke-width="1.4" stroke-dasharray="6 5"/>`;
    series.forEach((s) => { svg += curve(s, px, py, f); });
    svg += `<g class="overlay"><line class="now" y1="${top}" y2="${top + h}" stroke="var(--ink)" stroke-width="1.2" visibility="hidden"/>`
      + `<line class="here" y1="${top}" y2="${top + h}" stroke="var(--soft)" stroke-dasharray="2 3" visibility="hidden"/>`
      + series.map((s) => `<circle r="3.6" fill="${s.color}" stroke="var(--card)" stroke-width="1.2" visibility="hidden"/>`).join('') + '</g>';
    const description = series.map((s) => {
      const finite = s.y.filter(isNumber);
      return `${s.name} from ${shownValue(finite[0])} to ${shownValue(finite[finite.length - 1])}`;
    }).join(', ');
    plot.innerHTML = `<svg viewBox="0 0 ${width} ${height}" height="${height}" role="img">${svg}</svg>`;
    plot.firstChild.setAttribute('aria-label', `${spec.title}: ${description}`);
    overlay = {
      now: plot.querySelector('.now'), here: plot.querySelector('.here'), dots: [...plot.querySelectorAll('.overlay circle')],
    };
    scale = { px, py, left, w };
    update();
  }

  function curve(s, px, py, f) {
    let path = '', pen = false, marks = '';
    const marked = s.dots || s.y.length === 1 || (spec.x.whole && s.y.length <= 80);
    s.y.forEach((v, i) => {
      if (!isNumber(v) || !isNumber(s.x[i])) { pen = false; return; }
      const column = f(px(s.x[i])), row = f(py(v));
      if (s.dots) path += '';
      else if (s.hold) path += `${pen ? 'V' + row : `M${column},${row}`}H${f(px(s.x[i + 1]))}`;
      else path += `${pen ? 'L' : 'M'}${column},${row}`;
      pen = true;
      const alone = !s.hold && !isNumber(s.y[i - 1]) && !isNumber(s.y[i + 1]);
      const clipped = log && v <= 0;
      if (marked && !s.hold || alone || (clipped && spec.x.whole))
        marks += `<circle cx="${column}" cy="${row}" r="${clipped ? 3.4 : 2.6}" fill="${clipped ? 'var(--card)' : s.color}" stroke="${s.color}"/>`;
    });
    let band = '';
    if (s.band && s.band.length) {
      const edge = (side) => s.y.map((v, i) => [s.x[i], v + side * s.band[i]]).filter(([x, v]) => isNumber(x) && isNumber(v));
      const around = [...edge(1), ...edge(-1).reverse()].map(([x, v]) => `${f(px(x))},${f(py(v))}`);
      band = `<polygon points="${around.join(' ')}" fill="${s.color}" fill-opacity="0.2"/>`;
    }
    const dashes = s.dashed ? ' stroke-dasharray="7 5"' : '';
    return `${band}<path d="${path}" fill="none" stroke="${s.color}" stroke-width="${s.wide ? 2.4 : s.thin ? 0.7 : 1.7}"${dashes} stroke-linejoin="round"/>${marks}`;
  }

  /** Cursor, hover line and the numbers in the legend. */
  function update() {
    if (!scale) return;
    const now = spec.synchronized ? clock.now : xRange[1];
    const x = hover ?? clamp(now, x0, x1);
    const place = (line, value, visible) => {
      line.setAttribute('visibility', visible ? 'visible' : 'hidden');
      if (visible) { line.setAttribute('x1', scale.px(value)); line.setAttribute('x2', scale.px(value)); }
    };
    place(overlay.now, now, spec.synchronized && now >= x0 && now <= x1);
    place(overlay.here, x, hover !== null);
    series.forEach((s, i) => {
      const v = valueAt(s, x);
      values[i].textContent = shownValue(v);
      const visible = isNumber(v) && (hover !== null || spec.synchronized);
      overlay.dots[i].setAttribute('visibility', visible ? 'visible' : 'hidden');
      if (visible) { overlay.dots[i].setAttribute('cx', scale.px(x)); overlay.dots[i].setAttribute('cy', scale.py(v)); }
    });
    if (spec.x.name !== CLOCK.name && !spec.x.whole) at.textContent = `${spec.x.name} ${format(x)} ${spec.x.unit}`;
    else at.textContent = spec.x.whole ? `${spec.x.name} ${x}${spec.remark ? spec.remark(x) : ''}` : clockText(x);
  }

  const pointerX = (event) => {
    const box = plot.getBoundingClientRect();
    const x = clamp(x0 + (event.clientX - box.left - scale.left) / scale.w * (x1 - x0), x0, x1);
    if (!spec.x.whole) return x;
    const known = series[0].x;
    return known.reduce((best, v) => Math.abs(v - x) < Math.abs(best - x) ? v : best, known[0]);
  };
  plot.addEventListener('pointermove', (event) => {
    if (!scale) return;
    hover = pointerX(event);
    if (spec.synchronized && event.buttons & 1) clock.set(hover);
    update();
  });
  plot.addEventListener('pointerdown', (event) => { if (scale && spec.synchronized) clock.set(pointerX(event)); });
  plot.addEventListener('pointerleave', () => { hover = null; update(); });
  if (spec.synchronized) clock.listeners.push(update);
  let seen = 0;
  new ResizeObserver(() => {
    if (plot.clientWidth === seen) return;
    seen = plot.clientWidth;
    requestAnimationFrame(render); // not at once: the new height would trigger the observer again
  }).observe(plot);
  return card;
}

function chartSection(title, specs) {
  const cards = specs.filter(Boolean).map(lineChart).filter(Boolean);
  if (cards.length) section(title, el('div', { class: 'charts' }, ...cards));
}

const TIME = { name: CLOCK.name, unit: CLOCK.unit };

/** Values beyond the first one: the zero of a potential energy is anywhere, and what changes is small beside it. */
const sinceStart = (values) => values.map((v) => isNumber(v) && isNumber(values[0]) ? v - values[0] : null);

/** Components and norm of a control, with its bounds. */
function controlChart(title, unitName, letter, names, values, bound) {
  const { t, hold } = data.controls;
  if (!values.some((v) => norm(v) > 0)) return null;
  const held = hold === 'constant';
  const series = names.map((name, i) => ({
    name: `${letter}${name}`, color: `var(--${'xyz'[i]})`, x: t, y: values.map((v) => v[i]), hold: held,
  }));
  const sizes = { name: `|${letter}|`, color: 'var(--norm)', x: t, y: values.map(norm), hold: held, wide: true };
  if (!held) {
    // The norm of a linear function is curved: sample it between the knots.
    sizes.x = []; sizes.y = [];
    values.forEach((v, i) => {
      const pieces = i + 1 < values.length ? 12 : 1;
      for (let k = 0; k < pieces; k++) {
        const s = k / 12;
        sizes.x.push(s ? t[i] + (t[i + 1] - t[i]) * s : t[i]);
        sizes.y.push(norm(s ? mix(v, values[i + 1], s) : v));
      }
    });
  }
  const bounds = [];
  if (bound && isNumber(bound.norm)) bounds.push({ name: `limit of |${letter}| ${format(bound.norm)}`, color: 'var(--bad)', values: [bound.norm] });
  if (bound && bound.axes) {
    if (bound.axes.every((b) => b === bound.axes[0]))
      bounds.push({ name: `limit \u00b1${format(bound.axes[0])} each`, color: 'var(--bad)', values: [bound.axes[0], -bound.axes[0]] });
    else bound.axes.forEach((b, i) => {
      if (isNumber(b) && b > 0) bounds.push({ name: `limit of ${letter}${names[i]} \u00b1${format(b)}`, color: `var(--${'xyz'[i]})`, values: [b, -b] });
    });
  }
  return { title, unit: unitName, x: TIME, series: [sizes, ...series], bounds, synchronized: true };
}

function timeCharts() {
  const specs = [];
  if (data.controls) {
    const { force, moment, force_bound, moment_bound } = data.controls;
    specs.push(controlChart('Tip force, spatial frame', 'N', 'f', ['x', 'y', 'z'].map((s) => '\u2009' + s), force, force_bound));
    specs.push(controlChart('Tip moment, body frame', 'N\u00b7m', 'm', ['\u2081', '\u2082', '\u2083'], moment, moment_bound));
  }
  if (data.energy) {
    const t = data.energy.t;
    const [kinetic, elastic, potential] = [data.energy.kinetic, data.energy.elastic, data.energy.potential].map(sinceStart);
    const total = t.map((_, i) => [kinetic, elastic, potential].every((e) => isNumber(e[i])) ? kinetic[i] + elastic[i] + potential[i] : null);
    const rows = [['total', 'var(--norm)', total, true], ['kinetic', 'var(--x)', kinetic], ['elastic', 'var(--z)', elastic], ['potential', 'var(--y)', potential]];
    specs.push({
      title: 'Energy beyond that at the start', unit: 'J', x: TIME, synchronized: true,
      series: rows.map(([name, color, y, wide]) => ({ name, color, x: t, y, wide })),
    });
  }
  if (data.target && isPoint(data.target.position)) {
    const distance = data.motion.tip.map((p) => isPoint(p) ? norm(sub(p, data.target.position)) : null);
    specs.push({
      title: 'Distance of the tip from the target', unit: 'm', x: TIME, synchronized: true, zero: true, exact: true, logChoice: true,
      series: [{ name: 'distance', color: 'var(--target)', x: data.motion.t, y: distance, wide: true }],
    });
  }
  if (data.paths.length) {
    const tip = data.motion.x.length ? data.motion.x[0].length - 1 : 0;
    const palette = ['var(--target)', 'var(--z)', 'var(--y)', 'var(--x)', 'var(--violet)', 'var(--norm)'];
    specs.push({
      title: 'Distance from the path to follow', unit: 'm', x: TIME, synchronized: true, zero: true, exact: true, logChoice: true,
      series: data.paths.map((path, i) => ({
        name: path.node === tip ? 'tip' : `node ${path.node}`, color: palette[i % palette.length], x: data.motion.t, y: path.off, wide: true,
      })),
    });
  }
  if (bodies.length) {
    const least = (body) => body.clearance.filter(isNumber).reduce((m, v) => Math.min(m, v), Infinity);
    const nearest = new Set([...bodies].sort((a, b) => least(a) - least(b)).slice(0, BODY_COLORS.length));
    const near = bodies.filter((body) => nearest.has(body));
    const kept = near.filter((body) => body.margin > 0);
    specs.push({
      title: bodies.some((body) => body.is_touched) ? 'Distance from bodies, negative where the arm presses into them'
        : near.length < bodies.length ? `Clearance of the nearest ${near.length} of ${bodies.length} obstacles` : 'Clearance of the obstacles',
      unit: 'm', x: TIME, synchronized: true, zero: true,
      series: near.map((body) => ({ name: body.name, color: `rgb(var(--${body.color}))`, x: body.t, y: body.clearance, wide: true })),
      bounds: [{ name: 'touching', color: 'var(--bad)', values: [0] }, ...kept.map((body) =>
        ({ name: `margin of ${body.name} ${format(body.margin)}`, color: `rgb(var(--${body.color}))`, values: [body.margin] }))],
    });
  }
  if (data.sensitivity) {
    const { t, open, closed } = data.sensitivity;
    const all = [...open, ...closed].filter((v) => v > 0);
    specs.push({
      title: 'Growth of a small disturbance', unit: 'times', x: TIME, synchronized: true, logChoice: true,
      note: 'A small deviation of the state at t = 0, measured by the square root of its energy, is at most this many times as large at t; 1: it neither grows nor fades. '
        + 'Feedback is the regulator in feedback.npz.',
      log: all.length > 1 && Math.max(...all) > 100 * Math.min(...all),
      series: [{ name: 'open loop', color: 'var(--x)', x: t, y: open }, { name: 'with feedback', color: 'var(--z)', x: t, y: closed }],
    });
  }
  chartSection(`Over ${CLOCK.words}`, specs);
}

function moreCharts() {
  const remark = (number) => NAMED ? ` \u00b7 ${nameAt(runs[0], number)}` : '';
  for (const title of new Set(data.charts.map((chart) => chart.section)))
    chartSection(title, data.charts.filter((chart) => chart.section === title).map((chart) => ({
      title: chart.title, unit: chart.unit, x: { name: chart.x_name, unit: chart.x_unit, whole: NAMED && chart.x_name === CLOCK.name }, synchronized: chart.x_name === CLOCK.name,
      // Of a fit, distances begin at zero, and places over time do not.
      zero: data.command === 'fit' ? chart.section === 'Residuals' : chart.x_name !== CLOCK.name, exact: chart.x_name !== CLOCK.name, remark,
      series: chart.series.map((s) => ({ ...s, color: `var(--${s.color})`, wide: s.color === 'norm' })),
    })));
}

function iterationCharts() {
  const rows = data.iterations;
  if (!rows.length) return;
  // Attempts follow each other, each with its own iterations, and a gap between them; so do grids.
  const several = data.attempts.length > 1, grids = rows.some((row) => row.grid > 1);
  const places = [], shown = [];
  rows.forEach((row, i) => {
    const before = i ? rows[i - 1] : row;
    if (row.attempt !== before.attempt || row.grid !== before.grid) { places.push(places.length); shown.push(null); }
    places.push(places.length);
    shown.push(row);
  });
  const remark = (i) => {
    const row = shown[i];
    if (!row) return '';
    const grid = grids ? `grid ${row.grid}, ` : '';
    const where = several || grids ? ` \u00b7 ${grid}attempt ${row.attempt}, iteration ${row.iteration}` : '';
    return `${where} \u00b7 ${row.kind ? row.kind + ', ' : ''}step ${format(row.step_norm)}`;
  };
  // Residuals below the rounding of the largest terms, which are 1, have no digits.
  const known = (v) => isNumber(v) && v < 1e-16 ? 0 : v;
  const column = (name, color) => ({ name, color, x: places, y: shown.map((r) => r ? (name === 'objective' ? r[name] : known(r[name])) : null) });
  const objective = rows.map((r) => r.objective).filter(isNumber);
  const axis = { name: grids ? 'iteration on all grids' : several ? 'iteration of all attempts' : 'iteration', whole: true };
  chartSection('Convergence', [
    { title: 'KKT residual', unit: '', x: axis, log: true, remark,
      series: [column('stationarity', 'var(--z)'), column('feasibility', 'var(--x)'), column('complementarity', 'var(--violet)')] },
    { title: 'Objective', unit: '', x: axis, remark, logChoice: objective.every((v) => v > 0),
      log: objective.length > 1 && objective.every((v) => v > 0) && Math.max(...objective) > 100 * Math.min(...objective),
      series: [{ ...column('objective', 'var(--y)'), wide: true }] },
  ]);
  if (several) attemptsTable();
  const words = new Set(data.kinds.map(([sign]) => sign).filter((sign) => sign.length > 1));
  const occurs = (sign) => rows.some(({ kind }) => kind === sign || (!words.has(kind) && kind !== '-' && kind.includes(sign)));
  const kinds = data.kinds.filter(([sign]) => occurs(sign));
  if (kinds.length) main.append(el('p', { class: 'note' }, 'Kinds of steps: ',
    ...kinds.flatMap(([sign, meaning], i) => [i ? '; ' : '', el('b', {}, sign), ` ${meaning}`]), '.'));
}
