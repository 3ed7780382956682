// ---------------------------------------------------------------- an arm and what belongs to it, in pieces with a depth

const FACETS = 16;

/** The pieces of one run's picture. A piece has a depth and draws itself. */
function armPieces(stage, run) {
  const { motion, arm, target } = run;
  const { context, size, up, e1, e2, project, toViewer, polygon, line, disc, label } = stage;
  const times = motion.t, frames = motion.x.length, nodes = motion.x[0].length;
  const base = () => colors[run.color];

  // Radii: as they are, unless too thin to see.
  const thinnest = 0.006 * size;
  const given = arm.radius.length === nodes && arm.radius.every(isNumber);
  const largest = given ? Math.max(...arm.radius) : 0;
  const thickening = given && largest > 0 ? Math.max(1, thinnest / largest) : 1;
  const radius = Array.from({ length: nodes }, (_, i) =>
    given && largest > 0 ? Math.max(arm.radius[i] * thickening, 0.15 * thinnest) : 1.6 * thinnest);

  /** Positions, and two unit vectors across the arm at every node, at any time. */
  function configuration(t) {
    const [i, j, s] = between(times, t);
    const x = [], a = [], b = [], tangent = [];
    for (let k = 0; k < nodes; k++) x.push(mix(motion.x[i][k], motion.x[j][k], s));
    for (let k = 0; k < nodes; k++) {
      const along = unit(sub(x[Math.min(k + 1, nodes - 1)], x[Math.max(k - 1, 0)]), up);
      const d1 = mix(motion.d1[i][k], motion.d1[j][k], s);
      const fallback = unit(cross(along, Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]), e1);
      tangent.push(along);
      a.push(unit(sub(d1, mul(along, dot(d1, along))), fallback));
      b.push(cross(along, a[k]));
    }
    return { x, a, b, tangent };
  }

  /** The arm as a flat ribbon, element by element. */
  function ghost(t, alpha, pieces) {
    const screen = configuration(t).x.map(project);
    const sides = screen.map((p, k) => {
      const before = screen[Math.max(k - 1, 0)], after = screen[Math.min(k + 1, nodes - 1)];
      const length = Math.hypot(after.x - before.x, after.y - before.y) || 1;
      const w = Math.max(radius[k] * p.scale, 0.8) / length;
      const nx = -(after.y - before.y) * w, ny = (after.x - before.x) * w;
      return [{ x: p.x + nx, y: p.y + ny }, { x: p.x - nx, y: p.y - ny }];
    });
    const pale = COMPARING ? base() : colors.ghost;
    const [fill, edge] = [rgba(pale, alpha), rgba(pale, alpha * 1.8)];
    for (let k = 0; k + 1 < nodes; k++) {
      const [[a, b], [c, d]] = [sides[k], sides[k + 1]];
      pieces.push({
        depth: (screen[k].depth + screen[k + 1].depth) / 2,
        draw() {
          polygon([a, c, d, b], fill);
          line(a, c, edge, 0.8);
          line(b, d, edge, 0.8);
        },
      });
    }
  }

  function tube(t, pieces) {
    const shape = configuration(t);
    const shade = stage.shading();
    const angle = (k) => (k - 0.5) / FACETS * 2 * Math.PI; // facet 0 is centered on d1
    const ringPoint = (i, phi) => add(shape.x[i], mul(add(mul(shape.a[i], Math.cos(phi)), mul(shape.b[i], Math.sin(phi))), radius[i]));
    const rings = shape.x.map((_, i) => Array.from({ length: FACETS }, (_, k) => project(ringPoint(i, angle(k)))));
    const tickStride = Math.max(1, Math.round((nodes - 1) / 20));
    for (let i = 0; i + 1 < nodes; i++) {
      for (let k = 0; k < FACETS; k++) {
        const phi = k / FACETS * 2 * Math.PI;
        const normal = add(mul(add(shape.a[i], shape.a[i + 1]), 0.5 * Math.cos(phi)), mul(add(shape.b[i], shape.b[i + 1]), 0.5 * Math.sin(phi)));
        const middle = add(mix(shape.x[i], shape.x[i + 1], 0.5), mul(normal, 0.5 * (radius[i] + radius[i + 1])));
        if (dot(normal, toViewer(middle)) <= -0.02 * norm(toViewer(middle))) continue;
        const n = (k + 1) % FACETS;
        const corners = [rings[i][k], rings[i][n], rings[i + 1][n], rings[i + 1][k]];
        const fill = shade(k === 0 ? colors.stripe : base(), normal);
        const edges = [[i, 0, 1], [i + 1, 3, 2]].filter(([node]) => node % tickStride === 0);
        pieces.push({
          depth: project(middle).depth, corners,
          draw() {
            polygon(corners, fill, fill);
            for (const [, p, q] of edges) line(corners[p], corners[q], 'rgba(10,20,30,.3)', 1);
          },
        });
      }
    }
    // Ticks along d1 stand out of the surface, so that twist shows from every side.
    for (let i = 0; i < nodes && !COMPARING; i += tickStride) {
      const foot = add(shape.x[i], mul(shape.a[i], radius[i]));
      const [p, q] = [project(foot), project(add(foot, mul(shape.a[i], 0.018 * size)))];
      pieces.push({ depth: (p.depth + q.depth) / 2, draw() { line(p, q, rgba(colors.stripe.map((c) => c * 0.85), 1), 1.8); } });
    }
    for (const [i, sign] of [[nodes - 1, 1], [0, -1]]) {
      const normal = mul(shape.tangent[i], sign);
      if (dot(normal, toViewer(shape.x[i])) <= 0 || (sign < 0 && arm.base)) continue;
      const fill = shade(base(), normal);
      pieces.push({ depth: project(shape.x[i]).depth - radius[i] * 0.5, draw() { polygon(rings[i], fill, 'rgba(10,20,30,.4)'); } });
    }
    if (arm.payload > 0) {
      const p = project(shape.x[nodes - 1]), r = Math.max(1.5 * radius[nodes - 1], 0.02 * size) * p.scale;
      const glow = context.createRadialGradient(p.x - r / 3, p.y - r / 3, r / 8, p.x, p.y, r);
      glow.addColorStop(0, rgba(colors.payload.map((c) => c + (255 - c) * 0.5), 1));
      glow.addColorStop(1, rgba(colors.payload, 1));
      pieces.push({ depth: p.depth - 1.5 * radius[nodes - 1], draw() { disc(p, r, glow, 'rgba(10,20,30,.5)', 1); } });
    }
  }

  /**
   * Tendons, chambers, muscles, cables and magnets where they are in the arm, seen through its surface: bold on the side of the viewer, faint behind the
   * axis. They are the wider the larger their effort is; without any they are dashed.
   */
  function routes(t, pieces) {
    const shape = configuration(t);
    const [i, j, s] = between(times, t);
    for (const route of run.routes || []) {
      const points = route.offsets.map(([a, b, c], k) => {
        const node = route.first + k;
        const out = add(mul(shape.a[node], a * thickening), mul(shape.b[node], b * thickening));
        return { at: add(add(shape.x[node], out), mul(shape.tangent[node], c)), faces: dot(out, toViewer(shape.x[node])) >= 0 };
      });
      if (route.moment) {
        magnet(route, shape, pieces);
        continue;
      }
      if (route.anchor) points.push({ at: route.anchor, faces: true });
      const effort = route.efforts[i] + (route.efforts[j] - route.efforts[i]) * s;
      const slack = route.slack[s < 0.5 ? i : j];
      const part = route.most > 0 ? clamp(Math.abs(effort) / route.most, 0, 1) : 0;
      const color = rgba(colors[route.color], 1), rim = rgba(colors.rim, 0.55);
      for (let k = 0; k + 1 < points.length; k++) {
        const [p, q] = [project(points[k].at), project(points[k + 1].at)];
        const faces = points[k].faces || points[k + 1].faces;
        const wide = 2 * route.radius * thickening * p.scale;
        pieces.push({
          // On top of the surface that they are seen through.
          depth: (p.depth + q.depth) / 2 - (faces ? 2.2 : 1.1) * largest * thickening,
          draw() {
            context.globalAlpha = faces ? 1 : 0.4;
            context.lineCap = wide > 0 ? 'butt' : 'round';
            if (wide > 0) {
              context.globalAlpha *= 0.35 + 0.5 * part;
              line(p, q, color, Math.max(wide, 2));
              context.globalAlpha = faces ? 1 : 0.4;
            }
            if (slack) context.setLineDash([3, 5]);
            if (!wide) {
              if (!slack) line(p, q, rim, 3.4 + 2.4 * part);
              line(p, q, color, slack ? 1.6 : 1.8 + 2.4 * part);
            } else if (slack) line(p, q, color, 1.6);
            context.setLineDash([]);
            context.lineCap = 'butt';
            context.globalAlpha = 1;
          },
        });
      }
    }
  }

  /** A magnet as a bar along its moment, whose north is bold; of a stretch of them some. */
  function magnet(route, shape, pieces) {
    const [a, b, c] = route.moment, stride = Math.ceil(route.offsets.length / 12);
    const half = Math.max(2.2 * largest * thickening, 0.035 * size) / (stride > 1 ? 2 : 1);
    for (let k = 0; k < route.offsets.length; k += stride) {
      const node = route.first + k, middle = shape.x[node];
      const way = add(add(mul(shape.a[node], a), mul(shape.b[node], b)), mul(shape.tangent[node], c));
      const [south, center, north] = [-half, 0, half].map((along) => project(add(middle, mul(way, along))));
      pieces.push({
        depth: center.depth - 2.2 * largest * thickening,
        draw() {
          line(south, north, rgba(colors.rim, 0.7), 7);
          line(south, center, colors.soft, 4.5);
          line(center, north, rgba(colors.magnet, 1), 4.5);
        },
      });
    }
  }

  function plate(pieces, amongBodies) {
    if (!isPoint(arm.base)) return;
    const start = configuration(clock.first);
    const normal = start.tangent[0], r = Math.max(2.6 * radius[0], 0.04 * size), thickness = 0.012 * size;
    const rim = (shift) => Array.from({ length: 40 }, (_, k) => {
      const phi = k / 40 * 2 * Math.PI;
      return project(add(add(arm.base, mul(normal, shift)), mul(add(mul(start.a[0], Math.cos(phi)), mul(start.b[0], Math.sin(phi))), r)));
    });
    const faces = dot(normal, toViewer(arm.base)) > 0;
    const [near, far] = faces ? [rim(0), rim(-thickness)] : [rim(-thickness), rim(0)];
    pieces.push({
      // Behind the arm, or in front of it; among obstacles, near where it is.
      depth: (faces ? 1 : -1) * (amongBodies ? r : Infinity) + project(arm.base).depth,
      draw() {
        const dark = rgba(colors.plate.map((c) => c * 0.72), 1);
        polygon(far, dark, dark);
        for (let k = 0; k < 40; k++) { const n = (k + 1) % 40; polygon([near[k], near[n], far[n], far[k]], dark, dark); }
        polygon(near, rgba(colors.plate, 1), rgba(colors.plate.map((c) => c * 0.72), 1), 1);
      },
    });
  }

  function tipPath(pieces) {
    const path = motion.tip.filter(isPoint).map(project);
    if (path.length !== frames) return;
    const color = COMPARING ? rgba(base(), 1) : colors.path;
    for (let i = 0; i + 1 < path.length; i++) {
      const future = times[i] >= clock.now;
      const [p, q] = [path[i], path[i + 1]];
      pieces.push({
        depth: (p.depth + q.depth) / 2,
        draw() {
          context.globalAlpha = future ? 0.32 : 1;
          context.lineCap = future ? 'butt' : 'round';
          line(p, q, color, future ? 1.6 : 2.4);
          context.globalAlpha = 1;
          context.lineCap = 'butt';
        },
      });
    }
  }

  /** The paths to follow with where on them a node should be now, and the points on the way. */
  function references(pieces) {
    for (const path of run.paths) {
      const corners = path.x.map(project);
      for (let i = 0; i + 1 < corners.length; i++) {
        const [p, q] = [corners[i], corners[i + 1]];
        pieces.push({
          depth: (p.depth + q.depth) / 2,
          draw() {
            context.globalAlpha = 0.6;
            line(p, q, colors.target, 4.5);
            context.globalAlpha = 1;
          },
        });
      }
      const now = project(shouldBe(path, clock.now));
      pieces.push({ depth: now.depth, draw() { disc(now, 4.5, colors.card, colors.target, 1.8); } });
    }
    for (const via of run.via) {
      if (!isPoint(via.position)) continue;
      const p = project(via.position), passed = clock.now >= via.t;
      const corners = [[0, -7], [7, 0], [0, 7], [-7, 0]].map(([x, y]) => ({ x: p.x + x, y: p.y + y }));
      pieces.push({
        depth: p.depth,
        draw() {
          polygon(corners, passed ? colors.target : colors.card, colors.target, 1.8);
          label(`t = ${format(via.t)} s`, { x: p.x + 7, y: p.y }, p, colors.target, 6);
        },
      });
    }
  }

  /** Markers of the shape that is shown, measured and predicted, with their names; those of the others are faint. */
  function marks(pieces) {
    const now = indexAt(times, clock.now), own = run.marks.filter((mark) => mark.frame === now);
    for (const mark of run.marks) {
      const shown = mark.frame === now;
      const [measured, predicted] = [project(mark.measured), project(mark.predicted)];
      const color = mark.outlier ? colors.bad : colors.target;
      pieces.push({
        // On top of the arm: they are what the picture is about.
        depth: shown ? -Infinity : measured.depth,
        draw() {
          context.globalAlpha = shown ? 1 : 0.3;
          line(measured, predicted, color, mark.outlier ? 2.4 : 1.6);
          disc(predicted, 3.2, colors.ink, colors.card, 1);
          disc(measured, shown ? 5.5 : 4, null, color, 2);
          context.globalAlpha = 1;
          if (shown && own.length <= 12 && !COMPARING) label(mark.name, { x: measured.x + 8, y: measured.y }, measured, colors.ink, 8);
        },
      });
    }
  }

  function goal(pieces) {
    if (!target) return;
    const place = isPoint(target.position) ? target.position : motion.tip[frames - 1];
    if (!isPoint(place)) return;
    const p = project(place);
    const reach = 0.035 * size;
    for (const axis of target.directions ? [] : [e1, e2, up]) {
      const [a, b] = [project(add(place, mul(axis, -reach))), project(add(place, mul(axis, reach)))];
      pieces.push({ depth: p.depth, draw() { line(a, b, colors.target, 1.8); } });
    }
    (target.directions || []).forEach((d, i) => {
      if (!d) return;
      const end = project(add(place, mul(d, 2.6 * reach)));
      pieces.push({
        depth: (p.depth + end.depth) / 2,
        draw() {
          line(p, end, colors['xyz'[i]], 2.4);
          label(`d${'\u2081\u2082\u2083'[i]}`, end, p, colors['xyz'[i]]);
        },
      });
    });
    if (isPoint(target.position)) pieces.push({
      // On top of the arm: the target is what the picture is about.
      depth: -Infinity,
      draw() {
        const r = Math.max(4, 0.009 * size * p.scale);
        context.globalAlpha = 0.85;
        disc(p, r, colors.target);
        context.globalAlpha = 1;
        disc(p, r, null, colors.card, 1.2);
        disc(p, r + 5, null, colors.target, 1.4);
      },
    });
  }

  return { run, frames, nodes, times, thickening, hasRadius: largest > 0, configuration, ghost, tube, routes, plate, tipPath, references, marks, goal };
}

// ---------------------------------------------------------------- forces and moments as arrows

/** Parts of the size of the picture that the longest arrow takes; a weight that is larger is drawn as long as this, and not in scale. */
const LONGEST_ARROW = 0.22, LONGEST_WEIGHT = 0.26;

const ARROW_UNITS = { force: 'N', moment: 'N\u00b7m', field: 'T' };
const swatchOf = (arrow) => arrow.name === 'weight' ? 'weight' : arrow.kind !== 'force' ? arrow.kind : arrow.name === 'control' ? 'force' : 'load';

/** Arrows of all runs in one scale for forces, one for moments and one for fields: their pieces, the legend, and their ends for the camera. */
function arrowPieces(runs, size) {
  const all = runs.flatMap((run) => run.arrows.map((arrow) => ({ ...arrow, run }))).filter((arrow) => arrow.peak > 0);
  const longest = (kind, weights) => all.filter((a) => a.kind === kind && (a.name === 'weight') === weights).reduce((m, a) => Math.max(m, a.peak), 0);
  const weight = longest('force', true);
  const scales = { force: LONGEST_ARROW * size / (longest('force', false) || weight || 1), moment: LONGEST_ARROW * size / (longest('moment', false) || 1), field: LONGEST_ARROW * size / (longest('field', false) || 1) };
  const clipped = weight * scales.force > LONGEST_WEIGHT * size;
  const colorOf = (arrow) => COMPARING ? rgba(colors[arrow.run.color], 1)
    : colors[swatchOf(arrow)];
  const lengthened = (arrow, v) => {
    const s = scales[arrow.kind];
    return arrow.name === 'weight' && clipped ? mul(v, LONGEST_WEIGHT * size / norm(v)) : mul(v, s);
  };
  const placed = (arrow, t) => {
    const { motion } = arrow.run;
    const [i, j, s] = between(motion.t, t);
    const foot = arrow.node === null ? mix(arrow.at[i], arrow.at[j], s) : mix(motion.x[i][arrow.node], motion.x[j][arrow.node], s);
    return [foot, mix(arrow.vectors[i], arrow.vectors[j], s)];
  };

  function pieces(stage, out) {
    const { project, line, polygon, label } = stage;
    const crowded = all.length > 8;
    for (const arrow of all) {
      const [foot, v] = placed(arrow, clock.now);
      if (!isPoint(foot) || !isPoint(v) || norm(v) < 1e-3 * arrow.peak) continue;
      const [p, q] = [project(foot), project(add(foot, lengthened(arrow, v)))];
      const length = Math.hypot(q.x - p.x, q.y - p.y);
      const color = colorOf(arrow);
      out.push({
        depth: Math.min(p.depth, q.depth) - 0.05 * size,
        draw() {
          const head = clamp(0.35 * length, 5, 11);
          const [dx, dy] = length > 1e-6 ? [(q.x - p.x) / length, (q.y - p.y) / length] : [1, 0];
          const tip = (at) => {
            const end = { x: q.x - dx * at, y: q.y - dy * at };
            return [end, { x: end.x - dx * head - dy * head * 0.42, y: end.y - dy * head + dx * head * 0.42 },
              { x: end.x - dx * head + dy * head * 0.42, y: end.y - dy * head - dx * head * 0.42 }];
          };
          line(p, { x: q.x - dx * head * 0.8, y: q.y - dy * head * 0.8 }, color, arrow.kind === 'moment' ? 2 : 2.8);
          polygon(tip(0), color);
          if (arrow.kind === 'moment') polygon(tip(head * 0.75), color);
          if (!crowded && length > 16) label(`${Number((Math.round(norm(v) / arrow.peak * 1000) / 1000 * arrow.peak).toPrecision(3))} ${ARROW_UNITS[arrow.kind]}`, q, p, color, 9);
        },
      });
    }
  }

  /** Names of what is drawn, with the longest of each kind: [color, text]. */
  function legend() {
    const groups = new Map();
    for (const arrow of all) {
      const key = `${arrow.name} ${arrow.kind}`, known = groups.get(key);
      if (!known || known.peak < arrow.peak) groups.set(key, arrow);
    }
    return [...groups.values()].map((arrow) => {
      const size = `${Number(arrow.peak.toPrecision(3))} ${ARROW_UNITS[arrow.kind]}`;
      const css = COMPARING ? 'var(--soft)' : `var(--${swatchOf(arrow)})`;
      if (arrow.name === 'weight') return [css, `weight ${size}${clipped ? ' (shortened)' : ''}`];
      if (arrow.kind === 'field') return [css, `magnetic field, at most ${size}`];
      const what = arrow.kind === 'moment' ? 'moment, double head' : 'force';
      return [css, `${arrow.name}: ${what}, at most ${size}`];
    });
  }

  const ends = all.flatMap((arrow) => arrow.run.motion.t.filter((_, i, all) => i % 8 === 0 || i + 1 === all.length).map((t) => {
    const [foot, v] = placed(arrow, t);
    return add(foot, lengthened(arrow, v));
  })).filter(isPoint);
  return { pieces, legend, ends, any: all.length > 0 };
}
