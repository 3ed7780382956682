// ---------------------------------------------------------------- tables and folded parts

/** A table in a box of its own; on a narrow screen every row becomes a block, with the heads beside the values. */
function stackedTable(heads, rows) {
  return el('div', { class: 'card wide' }, el('table', { class: 'stack' },
    el('thead', {}, el('tr', {}, ...heads.map((h) => el('th', { scope: 'col' }, h)))),
    el('tbody', {}, ...rows.map((cells) => el('tr', {}, ...cells.map((cell, i) => {
      const { text, tag = 'td', kind = '' } = typeof cell === 'string' ? { text: cell } : cell;
      return el(tag, { class: kind, 'data-head': heads[i], ...(tag === 'th' ? { scope: 'row' } : {}) }, text);
    }))))));
}

function attemptsTable() {
  section(data.iterations.some((row) => row.grid > 1) ? 'Attempts on the last grid' : 'Attempts', stackedTable(['Attempt', 'From', 'Iterations', 'How it ended'], data.attempts.map((a, i) => [
    { text: String(i + 1), kind: 'num' }, { text: a.from, tag: 'th' }, { text: String(a.iterations), kind: 'num' },
    a.is_result ? `${a.ended}: the result` : a.ended])));
}

function checksTable() {
  if (!data.checks.length) return;
  section('Checks', stackedTable(['State', 'Check', 'Found', 'Allowed', 'Meaning'], data.checks.map((c) => [
    { text: c.ok ? '\u2713 pass' : '\u2717 fail', kind: `state ${c.ok ? 'good' : 'bad'}` }, { text: c.name, tag: 'th' },
    { text: c.value, kind: 'num' }, { text: c.limit, kind: 'num' }, c.meaning])));
}

function factsTable() {
  if (!data.facts.length) return;
  const list = factsList(data.facts);
  list.classList.add('card');
  section('The run', list);
}

function rawSummary() {
  if (data.summary === null) return;
  main.append(el('details', { class: 'card' }, el('summary', {}, 'summary.json'),
    el('pre', { tabIndex: 0 }, JSON.stringify(data.summary, null, 2))));
}

/** Advice of the run, where there is any. */
function adviceSection() {
  if (data.advice.length) section('Advice', el('ul', { class: 'card advice' }, ...data.advice.map((sentence) => el('li', {}, sentence))));
}

/** Tables that a page brings with it. */
function moreTables() {
  for (const { title, heads, rows } of data.tables)
    section(title, stackedTable(heads, rows.map((row) => row.map((text, i) => i ? { text, kind: 'value text' } : { text, tag: 'th' }))));
}

/** Sizes beside each other. */
function barsSections() {
  for (const { section: heading, title, bars, note } of data.bars) {
    const most = Math.max(...bars.map(([, size]) => size).filter(isNumber));
    section(heading, el('div', { class: 'card chart bars' }, el('h3', {}, title), ...bars.map(([name, size, words], i) =>
      el('div', { class: i ? 'bar-row' : 'bar-row own' }, el('span', { class: 'name' }, name),
        el('span', { class: 'track' }, el('span', { class: 'fill', style: `width: ${isNumber(size) && most > 0 ? Math.max(100 * size / most, 0.4) : 0}%` })),
        el('span', { class: 'num' }, words))), note ? el('p', { class: 'note' }, note) : ''));
  }
}

/** The picture with what there is to know about the arm beside it. */
function motionSection() {
  const view = armView();
  const beside = el('div', { class: 'beside' });
  if (!COMPARING) {
    for (const [title, facts] of [['The arm', data.arm_facts], ['What acts on it', data.acting]])
      if (facts.length) beside.append(el('section', { class: 'card', 'aria-label': title }, el('h3', {}, title), factsList(facts)));
  }
  const parts = [view, beside.children.length ? beside : null].filter(Boolean);
  if (parts.length) main.append(el('section', { 'aria-label': 'Motion', class: 'stage' }, ...parts));
}

function imageSection() {
  const card = fieldImages();
  if (card) section(`Along the arm, over ${CLOCK.words}`, card);
}

// ---------------------------------------------------------------- several runs

function comparisonTables() {
  const two = runs.length === 2;
  for (const { title, rows } of data.tables) {
    const heads = ['Key', ...runs.map((run) => run.name), ...(two ? ['Change'] : [])];
    const table = stackedTable(heads, rows.map((row) => [
      { text: row.key, tag: 'th' }, ...row.values.map((text) => ({ text, kind: 'value' })), ...(two ? [{ text: row.change ?? '', kind: 'value' }] : [])]));
    if (title === 'Results' || title === 'Scenes') section(`${title}: what differs`, table);
    else main.append(el('details', { class: 'card' }, el('summary', {}, `${title} that differ (${rows.length})`), table));
  }
  if (!data.tables.length) section('What differs', el('p', { class: 'note' }, 'Nothing: the scenes and the summaries are the same.'));
}

function comparisonCharts() {
  const curves = (of) => runs.map((run) => {
    const points = of(run);
    return points && { name: run.name, color: `rgb(var(--${run.color}))`, wide: true, ...points };
  }).filter(Boolean);
  const sizes = (part) => curves((run) => run.controls && {
    x: run.controls.t, y: run.controls[part].map(norm), hold: run.controls.hold === 'constant',
  });
  const total = ({ energy: e }) => e && { x: e.t, y: sinceStart(e.t.map((_, i) => e.kinetic[i] + e.elastic[i] + e.potential[i])) };
  // Rounding of places is no motion: a chart of nothing else has nothing to show.
  const length = Math.max(...runs.map((run) => run.arm.length));
  const moves = (axis) => runs.some((run) => run.motion.tip.some((p) => isPoint(p) && Math.abs(p[axis]) > 1e-9 * length));
  const tip = (axis) => moves(axis) ? curves((run) => ({ x: run.motion.t, y: run.motion.tip.map((p) => p[axis]) })) : [];
  const off = curves((run) => run.target && isPoint(run.target.position) && {
    x: run.motion.t, y: run.motion.tip.map((p) => isPoint(p) ? norm(sub(p, run.target.position)) : null),
  });
  const missed = curves((run) => run.paths.length && { x: run.motion.t, y: run.paths[0].off });
  const time = { x: TIME, synchronized: true };
  chartSection(`Over ${CLOCK.words}`, [
    ...['x', 'y', 'z'].map((name, axis) => ({ title: `Tip, ${name}`, unit: 'm', ...time, series: tip(axis) })),
    { title: 'Distance of the tip from the target', unit: 'm', ...time, zero: true, exact: true, logChoice: true, series: off },
    { title: 'Distance from the path to follow', unit: 'm', ...time, zero: true, exact: true, logChoice: true, series: missed },
    { title: 'Size of the force on the tip', unit: 'N', ...time, zero: true, series: sizes('force') },
    { title: 'Size of the moment on the tip', unit: 'N\u00b7m', ...time, zero: true, series: sizes('moment') },
    { title: 'Total energy beyond that at the start', unit: 'J', ...time, series: curves(total) },
  ]);
  // Titles of charts that every run has, such as reactions of the base: of each the curve of the magnitude.
  const shared = runs[0].charts.filter((chart) => chart.section === 'Forces in the arm');
  chartSection('Forces in the arm', shared.map((chart) => ({
    title: chart.title, unit: chart.unit, ...time, zero: true,
    series: curves((run) => {
      const same = run.charts.find((other) => other.title === chart.title);
      return same && { x: same.series[0].x, y: same.series[0].y };
    }),
  })));
  // The rows of the last attempt, on the last grid: the last solve.
  const isLast = (row, end) => row.attempt === end.attempt && row.grid === end.grid;
  const iterations = (part) => curves((run) => {
    const rows = run.iterations.filter((row) => isLast(row, run.iterations[run.iterations.length - 1]));
    return rows.length && { x: rows.map((row) => row.iteration), y: rows.map(part) };
  });
  const axis = { x: { name: 'iteration of the last attempt', whole: true } };
  chartSection('Convergence', [
    { title: 'Largest KKT residual', unit: '', ...axis, log: true,
      series: iterations((row) => Math.max(row.stationarity, row.feasibility, row.complementarity)) },
    { title: 'Objective', unit: '', ...axis, series: iterations((row) => row.objective) },
  ]);
  if (data.tradeoff.length > 2) tradeoffChart();
}

/** Time against error: a point a run, and a line through those that no other beats in both. */
function tradeoffChart() {
  const front = data.tradeoff.filter((p) => p.on_front).sort((a, b) => a.wall_s - b.wall_s);
  const colorOf = (name) => `rgb(var(--${runs.find((run) => run.name === name).color}))`;
  chartSection('Trade-off', [{
    title: 'Error from elements and steps', unit: 'm', x: { name: 'wall time', unit: 's' }, log: true, exact: true,
    note: 'The line joins the front: no other of these results is both faster and more accurate.',
    series: [
      ...(front.length > 1 ? [{ name: 'front', color: 'var(--soft)', x: front.map((p) => p.wall_s), y: front.map((p) => p.error_m), thin: true }] : []),
      ...data.tradeoff.map((p) => ({ name: p.name, color: colorOf(p.name), x: [p.wall_s], y: [p.error_m] })),
    ],
  }]);
}
