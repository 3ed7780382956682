// ---------------------------------------------------------------- obstacles

/** The obstacles of all runs, each once. */
const bodies = runs.flatMap((run) => run.obstacles ? run.obstacles.bodies.map((body) => ({ ...body, t: run.obstacles.t })) : [])
  .filter((body, i, all) => all.findIndex((other) => JSON.stringify(other.shape) === JSON.stringify(body.shape)) === i)
  .map((body, i) => ({
  ...body, color: BODY_COLORS[i % BODY_COLORS.length], name: body.name.length > 48 ? body.name.slice(0, 47) + '\u2026' : body.name,
}));

/** Obstacles that a legend lists. */
const MOST_NAMES = 12;

/** Least and largest coordinates of an obstacle: infinite for a half-space, of which only its given point counts. */
function bodyBox(shape) {
  const about = (points, half) => [0, 1].map((most) => [0, 1, 2].map((i) =>
    most ? Math.max(...points.map((p) => p[i])) + half[i] : Math.min(...points.map((p) => p[i])) - half[i]));
  const { kind, radius: r } = shape;
  if (kind === 'sphere') return about([shape.center], [r, r, r]);
  if (kind === 'capsule') return about([shape.from, shape.to], [r, r, r]);
  if (kind === 'half_space') return about([shape.point], [0, 0, 0]);
  return about([shape.center], [0, 1, 2].map((i) => shape.axes.reduce((sum, axis, j) => sum + Math.abs(axis[i]) * shape.half_size[j], 0)));
}

/** The clearance of an obstacle at a time, between the rows of the record. */
function clearanceAt(body, t) {
  const [i, j, s] = between(body.t, t);
  const [before, after] = [body.clearance[i], body.clearance[j]];
  return isNumber(before) && isNumber(after) ? before + (after - before) * s : before;
}

/** The pieces of all obstacles. */
function bodyPieces(stage) {
  const { size, center, up, e1, project, toViewer, polygon, line } = stage;

  // Of every obstacle the facets that are near enough to be seen, or for a half-space a part of its plane.
  const nearby = 2.2 * size, facetSize = size / 16;
  const facetsAlong = (length) => clamp(Math.ceil(length / facetSize), 6, 32);

  /** Facets of a surface `at(u, v)`, which gives a point and the normal there for u and v from 0 to 1. */
  function facetsOf(at, rows, columns) {
    const facets = [];
    for (let r = 0; r < rows; r++) for (let c = 0; c < columns; c++) {
      const corners = [[r, c], [r, c + 1], [r + 1, c + 1], [r + 1, c]].map(([i, j]) => at(i / rows, j / columns).point);
      if (corners.every((p) => norm(sub(p, center)) < nearby))
        facets.push({ corners, ...at((r + 0.5) / rows, (c + 0.5) / columns) });
    }
    return facets;
  }

  /** A unit vector across `axis`, toward `point` where it can. */
  function across(axis, point) {
    const aside = Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
    return unit(sub(point, mul(axis, dot(point, axis))), unit(cross(axis, aside), e1));
  }

  const makeFacets = {
    // Of a very large sphere, the side toward the arm.
    sphere({ center: middle, radius: r }) {
      const pole = unit(sub(center, middle), up), a = across(pole, e1), b = cross(pole, a);
      const widest = Math.min(Math.PI, 1.5 * nearby / r), n = Math.max(22, facetsAlong(r * widest));
      return facetsOf((u, v) => {
        const [theta, phi] = [u * widest, v * 2 * Math.PI];
        const normal = add(mul(pole, Math.cos(theta)), mul(add(mul(a, Math.cos(phi)), mul(b, Math.sin(phi))), Math.sin(theta)));
        return { point: add(middle, mul(normal, r)), normal };
      }, n, 2 * n);
    },
    capsule({ from, to, radius: r }) {
      const length = norm(sub(to, from)), axis = unit(sub(to, from), up);
      const a = across(axis, sub(center, from)), b = cross(axis, a);
      const widest = Math.min(Math.PI, 1.5 * nearby / r), n = Math.max(36, facetsAlong(2 * r * widest));
      const around = (v) => add(mul(a, Math.cos((2 * v - 1) * widest)), mul(b, Math.sin((2 * v - 1) * widest)));
      const foot = dot(sub(center, from), axis);
      const [s0, s1] = [clamp(foot - nearby, 0, length), clamp(foot + nearby, 0, length)];
      const cap = (end, out) => facetsOf((u, v) => {
        const normal = add(mul(out, Math.cos(u * Math.PI / 2)), mul(around(v), Math.sin(u * Math.PI / 2)));
        return { point: add(end, mul(normal, r)), normal };
      }, Math.max(6, facetsAlong(r * Math.PI / 2)), n);
      const side = facetsOf((u, v) => {
        const normal = around(v);
        return { point: add(add(from, mul(axis, s0 + (s1 - s0) * u)), mul(normal, r)), normal };
      }, facetsAlong(s1 - s0), n);
      return [...(s1 > s0 ? side : []), ...cap(from, mul(axis, -1)), ...cap(to, axis)];
    },
    box({ center: middle, axes, half_size: half }) {
      const here = axes.map((axis) => dot(sub(center, middle), axis));
      const range = here.map((c, i) => [Math.max(-half[i], c - nearby), Math.min(half[i], c + nearby)]);
      if (range.some(([from, to]) => from >= to)) return [];
      return [0, 1, 2].flatMap((i) => [1, -1].flatMap((sign) => {
        const [j, k] = [(i + 1) % 3, (i + 2) % 3];
        const [[u0, u1], [v0, v1]] = [range[j], range[k]];
        const normal = mul(axes[i], sign), face = add(middle, mul(normal, half[i]));
        return facetsOf((u, v) => ({
          point: add(face, add(mul(axes[j], u0 + (u1 - u0) * u), mul(axes[k], v0 + (v1 - v0) * v))), normal,
        }), facetsAlong(u1 - u0), facetsAlong(v1 - v0));
      }));
    },
    half_space: () => [],
  };
  for (const body of bodies) {
    const { shape } = body;
    body.facets = makeFacets[shape.kind](shape);
    body.patch = null;
    if (shape.kind !== 'half_space') continue;
    const height = dot(sub(center, shape.point), shape.normal);
    if (Math.abs(height) < 1.2 * size) body.patch = {
      middle: sub(center, mul(shape.normal, height)), a: across(shape.normal, Math.abs(dot(shape.normal, up)) < 0.9 ? up : e1),
    };
  }

  function all(pieces) {
    const shade = stage.shading();
    for (const body of bodies) {
      const base = colors[body.color], moved = mul(body.velocity, clock.now);
      for (const facet of body.facets) {
        const point = add(facet.point, moved), eye = toViewer(point);
        if (dot(facet.normal, eye) <= -0.02 * norm(eye)) continue;
        const corners = facet.corners.map((corner) => project(add(corner, moved))), fill = shade(base, facet.normal);
        pieces.push({ depth: project(point).depth, corners, body, draw() { polygon(corners, fill, fill); } });
      }
      if (body.patch) pieces.push(planePiece(body));
    }
  }

  /** Part of a plane. The arm is on its outer side: in front of it, or, seen from behind, beyond. */
  function planePiece(body) {
    const { a } = body.patch, b = cross(body.shape.normal, a), half = 0.55 * size;
    const middle = add(body.patch.middle, mul(body.velocity, clock.now));
    const at = (u, v) => project(add(middle, add(mul(a, u * half), mul(b, v * half))));
    const corners = [at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)];
    const outside = dot(body.shape.normal, toViewer(middle)) > 0;
    const base = colors[body.color];
    return {
      depth: outside ? Infinity : -Infinity, corners, body,
      draw() {
        polygon(corners, rgba(base, outside ? 0.3 : 0.16), rgba(base, 0.8), 1.2);
        for (let i = -4; i <= 4; i++) {
          line(at(i / 5, -1), at(i / 5, 1), rgba(base, 0.3), 0.8);
          line(at(-1, i / 5), at(1, i / 5), rgba(base, 0.3), 0.8);
        }
      },
    };
  }

  return all;
}
