// ---------------------------------------------------------------- camera, and what is drawn with it

/** 1, 2 or 5 times a power of ten near `v`. */
function roundFigure(v) {
  const power = 10 ** Math.floor(Math.log10(v));
  return power * [1, 2, 5, 10].reduce((best, m) => Math.abs(m * power - v) < Math.abs(best * power - v) ? m : best, 1);
}

/**
 * A camera around `points`, and drawing with it on a canvas; `moving` are the first points, whose spread the camera looks across, and
 * `further` points that must be in the picture and do not widen the ground. Up is against gravity.
 */
function makeStage(canvas, points, moving, further, gravity) {
  const context = canvas.getContext('2d');
  const low = [0, 1, 2].map((i) => points.reduce((m, p) => Math.min(m, p[i]), Infinity));
  const high = [0, 1, 2].map((i) => points.reduce((m, p) => Math.max(m, p[i]), -Infinity));
  const center = mix(low, high, 0.5);
  const size = Math.max(norm(sub(high, low)), 1e-9);

  // e1 and e2 span the ground.
  const up = unit(mul(gravity, -1), [0, 0, 1]);
  const aside = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const e1 = unit(sub(aside, mul(up, dot(aside, up))), [1, 0, 0]);
  const e2 = cross(up, e1);
  const groundHeight = points.reduce((m, p) => Math.min(m, dot(p, up)), Infinity) - 0.015 * size;

  // The camera looks across the direction in which the motion extends most.
  let home = -1.05;
  {
    let m1 = 0, m2 = 0, s11 = 0, s12 = 0, s22 = 0;
    const some = points.slice(0, moving);
    for (const p of some) { m1 += dot(p, e1) / moving; m2 += dot(p, e2) / moving; }
    for (const p of some) {
      const a = dot(p, e1) - m1, b = dot(p, e2) - m2;
      s11 += a * a; s12 += a * b; s22 += b * b;
    }
    const spread = Math.hypot(s11 - s22, 2 * s12);
    if (spread > 0.4 * (s11 + s22)) {
      const across = 0.5 * Math.atan2(2 * s12, s11 - s22) + Math.PI / 2;
      const options = [across, across - Math.PI].map((a) => Math.atan2(Math.sin(a), Math.cos(a)));
      home = options.sort((a, b) => Math.abs(a - home) - Math.abs(b - home))[0] + 0.4;
    }
  }
  const HOME_PITCH = 0.24;
  const view = { yaw: home, pitch: HOME_PITCH, zoom: 1, pan: [0, 0], perspective: true };
  const stage = { context, center, size, up, e1, e2, view, camera: null };

  function aim(yaw, pitch) {
    const back = add(mul(add(mul(e1, Math.cos(yaw)), mul(e2, Math.sin(yaw))), Math.cos(pitch)), mul(up, Math.sin(pitch)));
    const right = unit(cross(up, back), e1);
    return { back, right, top: cross(back, right) };
  }

  /** Screen position and depth away from the viewer; `scale` is pixels per meter there. */
  stage.project = (p) => {
    const { camera } = stage, d = sub(p, center);
    const depth = -dot(d, camera.back);
    const scale = camera.scale / (view.perspective ? Math.max(0.15, 1 + depth / (2.6 * size)) : 1);
    return { x: camera.x + dot(d, camera.right) * scale, y: camera.y - dot(d, camera.top) * scale, depth, scale };
  };
  stage.toViewer = (p) => view.perspective ? sub(add(center, mul(stage.camera.back, 2.6 * size)), p) : stage.camera.back;

  /** Corners of the ground, in cells along e1 and e2. */
  const cell = stage.cell = roundFigure(size / 7);
  const groundRange = (axis) => {
    const [least, most] = points.reduce((m, p) => [Math.min(m[0], dot(p, axis)), Math.max(m[1], dot(p, axis))], [Infinity, -Infinity]);
    return [Math.floor(least / cell - 0.1), Math.ceil(most / cell + 0.1)];
  };
  const [[u0, u1], [v0, v1]] = [groundRange(e1), groundRange(e2)];
  const groundPoint = (u, v) => add(add(mul(e1, u * cell), mul(e2, v * cell)), mul(up, groundHeight));
  const framed = [...points, ...further, groundPoint(u0, v0), groundPoint(u1, v0), groundPoint(u0, v1), groundPoint(u1, v1)];

  /** Everything on the screen of the home view at one pixel per meter: [left, right, top, bottom]. */
  const frame = (perspective) => {
    const now = view.perspective;
    view.perspective = perspective;
    stage.camera = { ...aim(home, HOME_PITCH), scale: 1, x: 0, y: 0 };
    const box = framed.map(stage.project).reduce((m, p) =>
      [Math.min(m[0], p.x), Math.max(m[1], p.x), Math.min(m[2], p.y), Math.max(m[3], p.y)], [Infinity, -Infinity, Infinity, -Infinity]);
    view.perspective = now;
    return box;
  };
  const frameBoxes = { true: frame(true), false: frame(false) };

  stage.setCamera = (width, height) => {
    const [left, right, top, bottom] = frameBoxes[view.perspective];
    const scale = view.zoom * Math.min((width - 90) / Math.max(right - left, 1e-9), (height - 56) / Math.max(bottom - top, 1e-9));
    stage.camera = {
      ...aim(view.yaw, view.pitch), scale,
      x: width / 2 + view.pan[0] - (left + right) / 2 * scale,
      y: height / 2 + view.pan[1] - (top + bottom) / 2 * scale,
    };
  };
  stage.reset = () => Object.assign(view, { yaw: home, pitch: HOME_PITCH, zoom: 1, pan: [0, 0] });

  stage.polygon = (corners, fill, stroke, width = 0.8) => {
    context.beginPath();
    corners.forEach((c, i) => i ? context.lineTo(c.x, c.y) : context.moveTo(c.x, c.y));
    context.closePath();
    context.fillStyle = fill;
    context.fill();
    if (stroke) { context.strokeStyle = stroke; context.lineWidth = width; context.stroke(); }
  };
  stage.line = (p, q, color, width) => {
    context.beginPath();
    context.moveTo(p.x, p.y);
    context.lineTo(q.x, q.y);
    context.strokeStyle = color;
    context.lineWidth = width;
    context.stroke();
  };
  stage.disc = (p, r, fill, stroke, width) => {
    context.beginPath();
    context.arc(p.x, p.y, r, 0, 2 * Math.PI);
    if (fill) { context.fillStyle = fill; context.fill(); }
    if (stroke) { context.strokeStyle = stroke; context.lineWidth = width; context.stroke(); }
  };
  /** A word beyond the end of a line, with a rim of the background so that it can be read on anything. */
  stage.label = (text, at, from, color, gap = 10) => {
    const length = Math.hypot(at.x - from.x, at.y - from.y) || 1;
    const [dx, dy] = [(at.x - from.x) / length, (at.y - from.y) / length];
    context.font = '600 12px system-ui, sans-serif';
    context.textAlign = Math.abs(dx) > 0.5 && text.length > 2 ? (dx > 0 ? 'left' : 'right') : 'center';
    context.textBaseline = 'middle';
    context.lineJoin = 'round';
    context.strokeStyle = colors['view-top'];
    context.lineWidth = 3.5;
    const [x, y] = [at.x + dx * gap, at.y + dy * gap];
    context.strokeText(text, x, y);
    context.fillStyle = color;
    context.fillText(text, x, y);
  };

  stage.drawGround = () => {
    const at = (u, v) => stage.project(groundPoint(u, v));
    stage.polygon([at(u0, v0), at(u1, v0), at(u1, v1), at(u0, v1)], rgba(colors.ground, 0.05));
    for (let u = u0; u <= u1; u++) stage.line(at(u, v0), at(u, v1), rgba(colors.ground, u ? 0.2 : 0.42), 1);
    for (let v = v0; v <= v1; v++) stage.line(at(u0, v), at(u1, v), rgba(colors.ground, v ? 0.2 : 0.42), 1);
  };
  stage.drawTriad = (height) => {
    const origin = { x: 46, y: height - 46 };
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis, i) => ({
      name: 'xyz'[i], depth: -dot(axis, stage.camera.back),
      x: origin.x + 26 * dot(axis, stage.camera.right), y: origin.y - 26 * dot(axis, stage.camera.top),
    }));
    for (const axis of axes.sort((a, b) => b.depth - a.depth)) {
      stage.line(origin, axis, colors[axis.name], 2.2);
      if (Math.hypot(axis.x - origin.x, axis.y - origin.y) > 5) stage.label(axis.name, axis, origin, colors[axis.name]);
    }
  };
  /** Colors of surfaces by their normal, under a light beside the viewer. */
  stage.shading = () => {
    const { camera } = stage;
    const light = unit(add(add(camera.back, mul(camera.top, 0.65)), mul(camera.right, -0.35)), camera.back);
    return (base, normal) => {
      const brightness = 0.55 + 0.58 * Math.max(0, dot(normal, light));
      return rgba(base.map((c) => brightness <= 1 ? c * brightness : c + (255 - c) * (brightness - 1) * 3), 1);
    };
  };
  return stage;
}
