const data = JSON.parse(document.getElementById('data').textContent);
const main = document.getElementById('main');

// ---------------------------------------------------------------- elements, numbers, vectors

/** An element with properties (`aria-…`, `role` and `class` as attributes) and children; strings become text. */
function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.includes('-') || key === 'role' || key === 'class' || key === 'scope') element.setAttribute(key, value);
    else element[key] = value;
  }
  element.append(...children);
  return element;
}

function section(title, ...children) {
  const node = el('section', { 'aria-label': title }, el('h2', {}, title), ...children);
  main.append(node);
  return node;
}

const isNumber = (v) => typeof v === 'number' && Number.isFinite(v);
const clamp = (v, low, high) => Math.min(high, Math.max(low, v));
const minus = (text) => text.replace('-', '\u2212');
const superscript = (n) => [...String(n)].map((c) => c === '-' ? '\u207b' : '\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079'[c]).join('');

/** Four significant digits, three where a power of ten is needed. */
function format(v) {
  if (!isNumber(v)) return '\u2013';
  if (v === 0) return '0';
  const size = Math.abs(v);
  if (size >= 1e-3 && size < 99995) return minus(String(Number(v.toPrecision(4))));
  const [mantissa, exponent] = v.toExponential(2).split('e');
  return minus(String(Number(mantissa))) + '\u00b7' + '10' + superscript(Number(exponent));
}

/** The same, without digits below a ten-thousandth of the largest number that it stands beside. */
function formatBeside(v, largest) {
  if (!isNumber(v) || !(largest > 0)) return format(v);
  const unit = 10 ** Math.floor(Math.log10(largest) - 3.99);
  return format(Number((Math.round(v / unit) * unit).toPrecision(6)));
}

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const mul = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(a[0], a[1], a[2]);
const mix = (a, b, s) => [a[0] + (b[0] - a[0]) * s, a[1] + (b[1] - a[1]) * s, a[2] + (b[2] - a[2]) * s];
const isPoint = (a) => Array.isArray(a) && a.every(isNumber);
function unit(a, otherwise) {
  const size = norm(a);
  return size > 1e-30 ? mul(a, 1 / size) : otherwise;
}

/** Last index with `times[index] <= t`, at least 0. */
function indexAt(times, t) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

/** Neighbors of a time among others, and the part of the way between them. */
function between(times, t) {
  const i = indexAt(times, t), j = Math.min(i + 1, times.length - 1);
  const span = times[j] - times[i];
  return [i, j, span > 0 ? clamp((t - times[i]) / span, 0, 1) : 0];
}

/** Where a path wants its node at a time. */
function shouldBe(path, t) {
  const [i, j, s] = between(path.t, t);
  return mix(path.x[i], path.x[j], s);
}

// ---------------------------------------------------------------- what is shown: one run, or several beside each other

const COMPARING = Array.isArray(data.runs);
const RUN_COLORS = ['run0', 'run1', 'run2', 'run3', 'run4', 'run5'];
const runs = COMPARING
  ? data.runs.map((run, i) => ({ ...run.data, name: run.name, color: RUN_COLORS[i % RUN_COLORS.length] }))
  : [{ ...data, name: data.title, color: 'arm' }];

/** What the times of the motions are: the time, the load factor of statics, or the number of a shape, with names and nothing in between. */
const CLOCK = runs[0].clock;
const NAMED = Boolean(runs[0].motion.names);
const clockText = (t, text = format(t)) => `${CLOCK.symbol} = ${text}${CLOCK.unit ? ' ' + CLOCK.unit : ''}`;

/** Name of a run's frame at a time. */
const nameAt = ({ motion }, t) => motion.names[indexAt(motion.t, t)];

/** Position of a run's tip at a time. */
function tipAt({ motion }, t) {
  const [i, j, s] = between(motion.t, t);
  return mix(motion.tip[i], motion.tip[j], s);
}

/**
 * The most telling instant: of a fit the shape with the marker that is farthest off, the end of a motion with a target, or else when a node is farthest from where it began; of several runs,
 * when the tips are farthest from that of the first.
 */
function tellingInstant() {
  const { motion, target, via, marks } = runs[0];
  if (COMPARING) {
    const apart = (t) => Math.max(...runs.map((run) => norm(sub(tipAt(run, t), tipAt(runs[0], t)))));
    const best = motion.t.reduce((best, t) => apart(t) > apart(best) ? t : best, motion.t[0] ?? 0);
    if (apart(best) > 0) return best;
  }
  const apart = ({ measured, predicted }) => norm(sub(measured, predicted));
  if (marks) return motion.t[marks.reduce((worst, mark) => apart(mark) > apart(worst) ? mark : worst).frame];
  const last = motion.t.length - 1;
  if (target || via.length || last < 1) return motion.t[last] ?? 0;
  let best = last, most = -1;
  motion.x.forEach((frame, i) => {
    const way = frame.reduce((m, p, k) => Math.max(m, norm(sub(p, motion.x[0][k]))), 0);
    if (way > most * (1 + 1e-6)) { most = way; best = i; }
  });
  return motion.t[best];
}

/** One clock for pictures, slider and charts. */
const clock = {
  first: Math.min(...runs.map((run) => run.motion.t[0] ?? 0)),
  last: Math.max(...runs.map((run) => run.motion.t[run.motion.t.length - 1] ?? 0)),
  now: 0,
  listeners: [],
  set(t) {
    this.now = clamp(NAMED ? Math.round(t) : t, this.first, this.last);
    for (const listener of this.listeners) listener(this.now);
  },
};

// ---------------------------------------------------------------- header

const VERBS = { simulate: 'simulation', solve: 'optimal control', mpc: 'closed loop', equilibrium: 'statics', fit: 'fit to measurements' };

/** Keys that the head of a comparison names. */
const MOST_CHANGES = 4;

/** Text in which no line breaks between a number and its unit. */
const joined = (text) => text.replace(/(\d) (?=[A-Za-z%\u00b7]{1,3}\b|%)/g, '$1\u00a0');

function badge(verdict) {
  const [tone, sign] = !verdict.ok ? ['bad', '\u2717'] : verdict.checked ? ['good', '\u2713'] : ['done', '\u2022'];
  return el('div', { class: `badge ${tone}`, role: 'status' }, el('span', { 'aria-hidden': 'true' }, sign), verdict.text);
}

function pageHeader() {
  const header = document.getElementById('header');
  header.append(el('div', { class: 'title' }, el('p', {}, `softarm \u00b7 ${COMPARING ? `${runs.length} results of ` : ''}${VERBS[data.command]}`),
    el('h1', {}, data.title)));
  if (!COMPARING) {
    header.append(badge(data.verdict),
      el('div', { class: 'lead' }, el('p', { class: 'sentence' }, joined(data.lead)), el('p', { class: 'trust' }, joined(data.trust))));
    return;
  }
  header.append(el('div', { class: 'lead' }, ...runs.map((run) => el('p', { class: 'run' },
    el('span', { class: 'swatch solid', style: `background: rgb(var(--${run.color}))` }), el('b', {}, run.name), ' ', badge(run.verdict), ' ', joined(run.lead)))));
  // What was changed comes first: everything else follows from it.
  const changed = data.tables.find(({ title }) => title === 'Scenes');
  if (changed) header.lastChild.prepend(el('p', { class: 'sentence' }, 'They differ in ', ...changed.rows.slice(0, MOST_CHANGES).flatMap((row, i) => [
    i ? '; ' : '', el('b', {}, row.key), ` (${row.values.join(', ')})`]), changed.rows.length > MOST_CHANGES ? ` and ${changed.rows.length - MOST_CHANGES} more keys.` : '.'));
}

function factsList(facts) {
  return el('dl', { class: 'facts' }, ...facts.map(([name, value]) =>
    el('div', {}, el('dt', {}, name), el('dd', { class: 'num' }, value))));
}

/** Colors of the style sheet by name, as the theme has them now. */
let colors = {};
const themeListeners = [];
function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['ink', 'soft', 'bad', 'x', 'y', 'z', 'path', 'target', 'view-top', 'view-bottom', 'card', 'line', 'force', 'moment', 'field', 'weight', 'load'])
    colors[name] = style.getPropertyValue('--' + name).trim();
  for (const name of ['arm', 'stripe', 'plate', 'ground', 'ghost', 'payload', 'tendon', 'chamber', 'muscle', 'magnet', 'cable', 'rim', ...BODY_COLORS, ...RUN_COLORS])
    colors[name] = style.getPropertyValue('--' + name).trim().split(/\s+/).map(Number);
}
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => { readColors(); for (const listener of themeListeners) listener(); });

/** Obstacles in their order take these in turn. */
const BODY_COLORS = ['body0', 'body1', 'body2', 'body3', 'body4', 'body5'];
const rgba = (c, alpha) => `rgba(${c[0] | 0},${c[1] | 0},${c[2] | 0},${alpha})`;
