// Charts: what hangs together in the lightmap.
//
// Atlas coordinates are unique, so two triangles belong to one chart exactly when a chain of triangles with common
// corners leads from one to the other; corners are common where page and coordinates are the same, bit for bit.

// Which chart each corner of some triangles belongs to. `parts`: { page, uv (two floats a vertex), index (or null) }.
// Returns for each part a list with a number for each vertex, and how many charts there are.
export function chartsOf(parts) {
  const parents = [];
  const root = (i) => {
    while (parents[i] !== i) i = parents[i] = parents[parents[i]];
    return i;
  };
  const known = new Map();
  const bits = new Uint32Array(2);
  const floats = new Float32Array(bits.buffer);
  const corner = (page, u, v) => {
    // -0 is 0.
    [floats[0], floats[1]] = [u + 0, v + 0];
    const key = `${page},${bits[0]},${bits[1]}`;
    if (!known.has(key)) known.set(key, parents.push(parents.length) - 1);
    return known.get(key);
  };
  const corners = parts.map(({ page, uv }) =>
    Int32Array.from({ length: uv.length / 2 }, (_, i) => corner(page, uv[2 * i], uv[2 * i + 1])));
  const used = new Set();
  parts.forEach(({ index, uv }, part) => {
    const count = index === null ? uv.length / 2 : index.length;
    const at = (i) => corners[part][index === null ? i : index[i]];
    for (let i = 0; i + 2 < count; i += 3) {
      parents[root(at(i + 1))] = root(at(i));
      parents[root(at(i + 2))] = root(at(i));
      used.add(at(i));
    }
  });
  const numbers = new Map();
  for (const i of used) if (!numbers.has(root(i))) numbers.set(root(i), numbers.size);
  // A vertex that no triangle uses is in no chart.
  const lists = corners.map((list) => Float32Array.from(list, (i) => numbers.get(root(i)) ?? -1));
  return { lists, count: numbers.size };
}
