// ---------------------------------------------------------------- quantities over arc length and time

/** Stops of a map for magnitudes and of one for what may be above or below a neutral value, light and dark. */
const MAPS = {
  magnitude: [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], // viridis
  signed: [[33, 102, 172], [146, 197, 222], [240, 240, 240], [244, 165, 130], [178, 24, 43]],
};

function mapped(stops, part) {
  const at = clamp(part, 0, 1) * (stops.length - 1), i = Math.min(Math.floor(at), stops.length - 2);
  return stops[i].map((c, k) => Math.round(c + (stops[i + 1][k] - c) * (at - i)));
}

const CODES = 1000;

/**
 * The card with one image a run: time to the right, arc length up, color the chosen quantity. It moves and follows the clock. Several
 * runs share the scale.
 */
function fieldImages() {
  const shown = runs.filter((run) => run.fields && run.fields.fields.length);
  if (!shown.length) return null;
  const names = [...new Set(shown.flatMap((run) => run.fields.fields.map((field) => field.name)))];
  const select = el('select', { 'aria-label': 'Quantity of the image' }, ...names.map((name) => el('option', { value: name }, name)));
  const scaleBar = el('canvas', { class: 'scale', 'aria-hidden': 'true', width: 160, height: 1 });
  const lowText = el('span', { class: 'num' }), highText = el('span', { class: 'num' }), at = el('span', { class: 'at num' });
  const head = el('div', { class: 'head' }, select, el('span', { class: 'scale-box' }, lowText, scaleBar, highText), at);
  const card = el('div', { class: 'card chart image' }, head);

  /** The field of a run, and the range of all. */
  const fieldOf = (run) => run.fields.fields.find((field) => field.name === select.value);
  const range = () => {
    const fields = shown.map(fieldOf).filter(Boolean);
    return [Math.min(...fields.map((field) => field.low)), Math.max(...fields.map((field) => field.high)), fields[0]];
  };
  /** The index of the value at a fraction of the length, and the fraction at which a value stands. */
  const indexOf = (run, field, n, s) => {
    const places = run.fields.places;
    if (!places) return field.at_nodes ? Math.round(s * (n - 1)) : Math.min(Math.floor(s * n), n - 1);
    const next = places.findIndex((place) => place > s);
    const element = (next < 0 ? places.length - 1 : Math.max(next, 1)) - 1;
    return field.at_nodes && s - places[element] > places[element + 1] - s ? element + 1 : element;
  };
  const placeOf = (run, field, n, i) => {
    const places = run.fields.places;
    if (!places) return field.at_nodes ? i / (n - 1) : (i + 0.5) / n;
    return field.at_nodes ? places[i] : 0.5 * (places[i] + places[i + 1]);
  };
  const valueOf = (field, code) => field.low + (field.high - field.low) * code / CODES;
  const digitsOf = (field, value) => formatBeside(value, Math.max(Math.abs(field.low), Math.abs(field.high)) * 10);

  const images = shown.map((run) => {
    const canvas = el('canvas', { class: 'field', role: 'img' });
    const context = canvas.getContext('2d');
    const picture = document.createElement('canvas');
    if (COMPARING) card.append(el('p', { class: 'run' }, el('span', { class: 'swatch solid', style: `background: rgb(var(--${run.color}))` }), run.name));
    card.append(canvas);
    const margin = { left: 46, right: 10, top: 8, bottom: 34 };
    let hover = null;
    const place = () => {
      const width = canvas.clientWidth - margin.left - margin.right, height = canvas.clientHeight - margin.top - margin.bottom;
      return { width, height, x: (t) => margin.left + (t - clock.first) / (clock.last - clock.first || 1) * width };
    };

    function paint() {
      const field = fieldOf(run);
      if (!field) { picture.width = 0; return; }
      const [low, high] = range(), { t } = run.fields, values = field.codes[0].length;
      const stops = field.neutral === null ? MAPS.magnitude : MAPS.signed;
      const rows = run.fields.places ? 480 : values;
      const valueAt = (r) => run.fields.places ? indexOf(run, field, values, 1 - (r + 0.5) / rows) : rows - 1 - r;
      // Columns evenly spread in time, each of the frame that is nearest.
      const columns = clamp(2 * t.length, 2, 960), from = t[0], to = t[t.length - 1];
      picture.width = columns; picture.height = rows;
      const pixels = new ImageData(columns, rows);
      for (let c = 0; c < columns; c++) {
        const [i, j, s] = between(t, from + (to - from) * (c + 0.5) / columns);
        const codes = field.codes[s > 0.5 ? j : i];
        for (let r = 0; r < rows; r++) {
          const color = mapped(stops, (valueOf(field, codes[valueAt(r)]) - low) / (high - low));
          pixels.data.set([...color, 255], 4 * (r * columns + c));
        }
      }
      picture.getContext('2d').putImageData(pixels, 0, 0);
      canvas.setAttribute('aria-label', `${field.name} over arc length and ${CLOCK.words}, from ${format(low)} to ${format(high)} ${field.unit}`);
    }

    function draw() {
      const ratio = window.devicePixelRatio || 1, { width, height, x } = place();
      if (!(width > 0)) return;
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
      context.imageSmoothingEnabled = false;
      const { t, length } = run.fields;
      if (picture.width) context.drawImage(picture, x(t[0]), margin.top, x(t[t.length - 1]) - x(t[0]), height);
      context.strokeStyle = colors.line;
      context.lineWidth = 1;
      context.strokeRect(margin.left + 0.5, margin.top + 0.5, width - 1, height - 1);
      context.font = '12px system-ui, sans-serif';
      context.fillStyle = colors.soft;
      context.textBaseline = 'middle';
      context.textAlign = 'right';
      const lengths = ticks(0, length, 4), timesOf = ticks(clock.first, clock.last, clamp(width / 85, 2, 8));
      for (const s of lengths.values) context.fillText(lengths.text(s), margin.left - 6, margin.top + height * (1 - s / length));
      context.textAlign = 'center';
      for (const v of timesOf.values) context.fillText(timesOf.text(v), x(v), margin.top + height + 10);
      context.textAlign = 'right';
      context.fillText(CLOCK.unit ? `${CLOCK.name} (${CLOCK.unit})` : CLOCK.name, margin.left + width, margin.top + height + 26);
      context.textAlign = 'left';
      context.fillText('arc length (m): 0 is the base', 6, margin.top + height + 26);
      const here = x(clock.now);
      context.lineWidth = 3;
      context.strokeStyle = colors.card;
      for (const [color, thick] of [[colors.card, 4], [colors.ink, 1.6]]) {
        context.strokeStyle = color;
        context.lineWidth = thick;
        context.beginPath();
        context.moveTo(here, margin.top);
        context.lineTo(here, margin.top + height);
        context.stroke();
      }
      if (hover) {
        context.strokeStyle = colors.ink;
        context.lineWidth = 1.2;
        context.strokeRect(hover.x - 5, hover.y - 5, 10, 10);
      }
      readout();
    }

    /** The value under the pointer, or the largest now. */
    function readout() {
      const field = fieldOf(run);
      if (!field || (COMPARING && !hover)) return;
      const unit = field.unit ? ` ${field.unit}` : '', { t, length } = run.fields;
      if (hover) {
        const codes = field.codes[indexAt(t, hover.t)], n = codes.length;
        const i = indexOf(run, field, n, hover.s);
        at.textContent = `${digitsOf(field, valueOf(field, codes[i]))}${unit} at ${(hover.s * length).toPrecision(2)} m, ${clockText(hover.t)}`;
        return;
      }
      const codes = field.codes[indexAt(t, clock.now)], far = (code) => Math.abs(valueOf(field, code) - (field.neutral ?? 0));
      const best = codes.reduce((most, code, i) => far(code) > far(codes[most]) ? i : most, 0);
      const s = placeOf(run, field, codes.length, best) * length;
      at.textContent = `now at most ${digitsOf(field, valueOf(field, codes[best]))}${unit}, at ${s.toPrecision(2)} m`;
    }

    const pointed = (event) => {
      const box = canvas.getBoundingClientRect(), { width, height } = place();
      const x = clamp(event.clientX - box.left, margin.left, margin.left + width), y = clamp(event.clientY - box.top, margin.top, margin.top + height);
      return { x, y, t: clock.first + (x - margin.left) / width * (clock.last - clock.first), s: 1 - (y - margin.top) / height };
    };
    canvas.addEventListener('pointermove', (event) => {
      hover = pointed(event);
      if (event.buttons & 1) clock.set(hover.t); else draw();
    });
    canvas.addEventListener('pointerdown', (event) => clock.set(pointed(event).t));
    canvas.addEventListener('pointerleave', () => { hover = null; at.textContent = ''; draw(); });
    clock.listeners.push(draw);
    themeListeners.push(draw);
    new ResizeObserver(() => requestAnimationFrame(draw)).observe(canvas);
    return { paint, draw };
  });

  function choose() {
    const [low, high, field] = range();
    const stops = field.neutral === null ? MAPS.magnitude : MAPS.signed;
    const pixels = new ImageData(160, 1);
    for (let i = 0; i < 160; i++) pixels.data.set([...mapped(stops, i / 159), 255], 4 * i);
    scaleBar.getContext('2d').putImageData(pixels, 0, 0);
    lowText.textContent = digitsOf(field, low);
    highText.textContent = `${digitsOf(field, high)} ${field.unit}`;
    at.textContent = '';
    for (const image of images) { image.paint(); image.draw(); }
  }
  select.addEventListener('change', choose);
  choose();
  return card;
}
