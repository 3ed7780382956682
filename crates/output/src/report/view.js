// ---------------------------------------------------------------- the picture in space

/** The card of the picture with its controls; nothing where no run has a motion. */
function armView() {
  const shown = runs.filter((run) => run.motion.x.length && run.motion.x[0].length > 1);
  const moving = shown.flatMap((run) => run.motion.x.flat()).filter(isPoint);
  if (!moving.length) return null;

  const canvas = el('canvas', {
    tabIndex: 0, role: 'img',
    'aria-label': 'The arm in space. Drag or Shift and arrow keys turn it, the wheel or plus and minus zoom, double click or 0 resets.',
  });

  // Everything that is drawn: the motion, bases, targets, points on the way, paths, and of the obstacles what is near. A corner of a large
  // body is no reason to look from afar.
  const points = moving.concat(shown.flatMap((run) => [
    run.arm.base, run.target && run.target.position, ...run.via.map((via) => via.position), ...(run.marks || []).map((mark) => mark.measured)]).filter(isPoint));
  const counted = points.length;
  points.push(...shown.flatMap((run) => run.paths.flatMap((path) => path.x)).filter(isPoint));
  const box = (some) => [0, 1, 2].map((i) => some.reduce(([a, b], p) => [Math.min(a, p[i]), Math.max(b, p[i])], [Infinity, -Infinity]));
  {
    const extent = box(points), room = 0.3 * Math.hypot(...extent.map(([a, b]) => b - a));
    for (const { shape } of bodies) {
      const [from, to] = bodyBox(shape);
      const nearest = from.map((v, i) => Math.max(v, extent[i][0] - room)), farthest = to.map((v, i) => Math.min(v, extent[i][1] + room));
      if (!nearest.every((v, i) => v <= farthest[i])) continue;
      for (let corner = 0; corner < 8; corner++) points.push(nearest.map((v, i) => corner >> i & 1 ? farthest[i] : v));
    }
  }
  const size = Math.max(Math.hypot(...box(points).map(([a, b]) => b - a)), 1e-9);
  const arrows = arrowPieces(shown, size);
  const stage = makeStage(canvas, points, counted, arrows.ends, shown[0].arm.gravity);
  const { context, view } = stage;
  const arms = shown.map((run) => armPieces(stage, run));
  const allBodies = bodyPieces(stage);

  /** Name and clearance of the obstacle under the pointer. */
  function drawName() {
    const inside = (corners) => {
      const turns = corners.map((p, i) => {
        const q = corners[(i + 1) % corners.length];
        return (q.x - p.x) * (pointer.y - p.y) - (q.y - p.y) * (pointer.x - p.x);
      });
      return turns.every((s) => s >= 0) || turns.every((s) => s <= 0);
    };
    const top = drawn.findLast((piece) => piece.corners && inside(piece.corners));
    if (!top || !top.body) return;
    const clearance = clearanceAt(top.body, clock.now);
    const text = `${top.body.name}: ${format(Math.abs(clearance))} m ${clearance < 0 ? 'inside' : 'clear'}`;
    context.font = '600 13px system-ui, sans-serif';
    const width = context.measureText(text).width + 16;
    const x = clamp(pointer.x + 14, 4, Math.max(4, canvas.clientWidth - width - 4)), y = Math.max(4, pointer.y - 34);
    context.beginPath();
    context.rect(x, y, width, 26);
    context.fillStyle = colors.card;
    context.fill();
    context.strokeStyle = rgba(colors[top.body.color], 1);
    context.lineWidth = 1.2;
    context.stroke();
    context.fillStyle = colors.ink;
    context.textAlign = 'left';
    context.textBaseline = 'middle';
    context.fillText(text, x + 8, y + 13.5);
  }

  let showBodies = true, showArrows = true, showRoutes = true, drawn = [], pointer = null;
  let stroboscope = !COMPARING && arms[0].frames > 2;
  function draw() {
    const width = canvas.clientWidth, height = canvas.clientHeight, ratio = window.devicePixelRatio || 1;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const sky = context.createLinearGradient(0, 0, 0, height);
    sky.addColorStop(0, colors['view-top']);
    sky.addColorStop(1, colors['view-bottom']);
    context.fillStyle = sky;
    context.fillRect(0, 0, width, height);
    context.lineJoin = 'round';
    stage.setCamera(width, height);
    stage.drawGround();
    const pieces = [];
    if (showBodies) allBodies(pieces);
    for (const arm of arms) {
      const [first, last] = [arm.times[0], arm.times[arm.frames - 1]];
      if (stroboscope) for (const t of NAMED ? arm.times : [0, 1, 2, 3, 4, 5, 6].map((i) => first + (last - first) * i / 6)) arm.ghost(t, 0.13, pieces);
      arm.tube(clock.now, pieces);
      if (showRoutes) arm.routes(clock.now, pieces);
      if (!NAMED) arm.tipPath(pieces);
      arm.references(pieces);
      if (arm.run.marks) arm.marks(pieces);
      arm.goal(pieces);
      arm.plate(pieces, bodies.length > 0);
    }
    if (showArrows) arrows.pieces(stage, pieces);
    pieces.sort((a, b) => b.depth - a.depth);
    for (const piece of pieces) piece.draw();
    stage.drawTriad(height);
    drawn = pieces;
    if (pointer && bodies.length) drawName();
  }
  let pending = false;
  function redraw() {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; draw(); });
  }

  // Turning, zooming, panning.
  const zoomBy = (factor) => { view.zoom = clamp(view.zoom * factor, 0.2, 40); redraw(); };
  const turnBy = (yaw, pitch) => { view.yaw += yaw; view.pitch = clamp(view.pitch + pitch, -1.55, 1.55); redraw(); };
  const reset = () => { stage.reset(); redraw(); };
  const pointers = new Map();
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    canvas.classList.add('turning');
  });
  canvas.addEventListener('pointermove', (event) => {
    const before = pointers.get(event.pointerId);
    pointer = before ? null : { x: event.offsetX, y: event.offsetY };
    if (!before) {
      if (bodies.length) redraw();
      return;
    }
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    if (pointers.size === 2) {
      const other = [...pointers.values()].find((p) => p.pointerId !== event.pointerId);
      const gap = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY) || 1;
      zoomBy(gap(event) / gap(before));
    } else if (event.shiftKey || event.buttons & 6) {
      view.pan = [view.pan[0] + dx, view.pan[1] + dy];
      redraw();
    } else turnBy(-dx * 0.008, dy * 0.008);
    pointers.set(event.pointerId, event);
  });
  for (const type of ['pointerup', 'pointercancel']) canvas.addEventListener(type, (event) => {
    pointers.delete(event.pointerId);
    if (!pointers.size) canvas.classList.remove('turning');
  });
  canvas.addEventListener('pointerleave', () => { pointer = null; if (bodies.length) redraw(); });
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    zoomBy(Math.exp(-clamp(event.deltaY * (event.deltaMode ? 18 : 1), -300, 300) * 0.0016));
  }, { passive: false });
  canvas.addEventListener('dblclick', reset);
  canvas.addEventListener('keydown', (event) => {
    const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (event.shiftKey && turn) turnBy(...turn);
    else if (event.key === '+' || event.key === '=') zoomBy(1.15);
    else if (event.key === '-') zoomBy(1 / 1.15);
    else if (event.key === '0') reset();
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  // Play, scrub, speed.
  const duration = clock.last - clock.first;
  const moves = duration > 0;
  const play = el('button', { type: 'button', id: 'play' }, '\u25b6 Play');
  const slider = el('input', { type: 'range', min: 0, max: 1000, step: 'any', value: 1000, 'aria-label': CLOCK.name });
  const readout = el('output', { class: 'num' });
  const speeds = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];
  const usual = duration >= 1.5 && duration <= 20 ? 1
    : speeds.reduce((best, s) => Math.abs(Math.log(duration / s / 5)) < Math.abs(Math.log(duration / best / 5)) ? s : best, 1);
  const offered = speeds.filter((s) => s >= usual / 11 && s <= usual * 11);
  const speed = el('select', { id: 'speed' }, ...offered.map((s) => el('option', { value: s, selected: s === usual }, `${s}\u00d7`)));
  const pressed = (name, on, change) => {
    const button = el('button', { type: 'button', 'aria-pressed': String(on) }, name);
    button.addEventListener('click', () => {
      const now = button.getAttribute('aria-pressed') !== 'true';
      button.setAttribute('aria-pressed', String(now));
      change(now);
      redraw();
    });
    return button;
  };
  let playing = false, previous = 0;
  function tick(stamp) {
    if (!playing) return;
    const t = clock.now + (stamp - previous) / 1000 * Number(speed.value);
    previous = stamp;
    clock.set(t);
    if (t >= clock.last) setPlaying(false); else requestAnimationFrame(tick);
  }
  function setPlaying(on) {
    playing = on && moves && !NAMED;
    play.textContent = playing ? '\u275a\u275a Pause' : '\u25b6 Play';
    if (!playing) return;
    if (clock.now >= clock.last) clock.set(clock.first);
    previous = performance.now();
    requestAnimationFrame(tick);
  }
  play.addEventListener('click', () => setPlaying(!playing));
  slider.addEventListener('input', () => { setPlaying(false); clock.set(clock.first + duration * slider.value / 1000); });
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    const tag = event.target.tagName;
    if (tag === 'SELECT' || !moves) return;
    const { times } = arms[0], frames = times.length;
    const at = indexAt(times, clock.now), exact = times[at] === clock.now;
    const frame = { ArrowLeft: exact ? at - 1 : at, ArrowRight: at + 1, PageDown: at - 10, PageUp: at + 10, Home: 0, End: frames - 1 }[event.key];
    const ours = tag === 'INPUT' || tag === 'CANVAS';
    if (event.key === ' ' && tag !== 'BUTTON' && tag !== 'SUMMARY') setPlaying(!playing);
    else if (frame !== undefined && (ours || event.key.startsWith('Arrow'))) {
      setPlaying(false);
      clock.set(times[clamp(frame, 0, frames - 1)]);
    } else return;
    event.preventDefault();
  });
  const digits = clamp(Math.ceil(-Math.log10(duration / 1000 || 1)), 0, 9);
  clock.listeners.push((t) => {
    slider.value = duration > 0 ? (t - clock.first) / duration * 1000 : 0;
    slider.setAttribute('aria-valuetext', clockText(t));
    readout.textContent = NAMED ? `${t}: ${nameAt(arms[0].run, t)}` : clockText(t, minus(t.toFixed(digits)));
    redraw();
  });

  const bar = el('div', { class: 'bar' });
  if (moves) bar.append(...(NAMED ? [slider, readout] : [play, slider, readout, el('label', { htmlFor: 'speed', class: 'hidden' }, 'Speed'), speed]),
    pressed(NAMED ? 'All shapes' : 'Stroboscope', stroboscope, (on) => { stroboscope = on; }));
  if (arrows.any) bar.append(pressed('Forces', true, (on) => { showArrows = on; }));
  if (shown.some((run) => run.routes)) bar.append(pressed('Actuators', true, (on) => { showRoutes = on; }));
  if (bodies.length) bar.append(pressed('Obstacles', true, (on) => { showBodies = on; }));
  bar.append(pressed('Perspective', true, (on) => { view.perspective = on; }), (() => {
    const button = el('button', { type: 'button' }, 'Reset view');
    button.addEventListener('click', reset);
    return button;
  })());
  const card = el('div', { class: 'card' }, canvas, bar, pictureKey(stage, arms, arrows, moves));
  new ResizeObserver(redraw).observe(canvas);
  themeListeners.push(redraw);
  return card;
}

/** What the colors of the picture mean. */
function pictureKey(stage, arms, arrows, moves) {
  const entry = (color, text) => el('span', {}, el('span', { class: 'swatch', style: `border-color: ${color}` }), text);
  const block = (color, text) => el('span', {}, el('span', { class: 'swatch solid', style: `background: rgb(var(--${color}))` }), text);
  const key = el('div', { class: 'key' });
  const has = (of) => arms.some(({ run }) => of(run));
  if (COMPARING) key.append(...arms.map(({ run }) => block(run.color, run.name)));
  else if (moves && !NAMED) key.append(entry('var(--path)', 'path of the tip'));
  if (has((run) => run.marks)) key.append(entry('var(--target)', 'rings: measured markers; dots: predicted'));
  if (has((run) => run.marks && run.marks.some((mark) => mark.outlier))) key.append(entry('var(--bad)', 'outliers'));
  const most = Math.max(...runs.map((run) => run.paths.length));
  if (most) key.append(entry('var(--target)', most > 1 ? 'paths to follow' : 'path to follow'));
  if (has((run) => run.target)) key.append(entry('var(--target)', 'target'));
  if (has((run) => run.via.length)) key.append(entry('var(--target)', 'points on the way'));
  const payload = arms[0].run.arm.payload;
  if (payload > 0) key.append(block('payload', `payload ${format(payload)} kg`));
  const kinds = new Map(arms.flatMap(({ run }) => (run.routes || []).map((route) => [route.kind, route.color])));
  for (const [kind, color] of kinds) key.append(block(color, kind === 'magnet' ? 'north of a magnet' : `${kind}s, wider with their effort`));
  if (has((run) => (run.routes || []).some((route) => route.slack.some(Boolean))))
    key.append(el('span', {}, el('span', { class: 'swatch dashed', style: 'border-color: var(--soft)' }), 'slack'));
  for (const [color, text] of arrows.legend()) key.append(entry(color, text));
  for (const body of bodies.slice(0, MOST_NAMES)) key.append(block(body.color,
    body.patch || body.facets.length ? body.name : `${body.name} (too far away to be drawn)`));
  if (bodies.length > MOST_NAMES) key.append(el('span', {}, `and ${bodies.length - MOST_NAMES} more obstacles`));
  key.append(entry('rgb(var(--stripe))', 'first director d\u2081 (shows twist)'), el('span', {}, `ground grid ${format(stage.cell)} m`));
  const { thickening, hasRadius } = arms[0];
  if (thickening > 1) key.append(el('span', {}, `radius drawn ${Number(thickening.toPrecision(2))} times too large`));
  if (!hasRadius) key.append(el('span', {}, 'no radius given: drawn as a thin arm'));
  return key;
}
