// The numbers of the page: tg4mm/show/web/pack.py, whose tables this reads.

const bytesOfBase64 = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

/** The decompressed bytes of base64 text that holds a zlib stream. */
export async function inflate(text) {
  const stream = new Blob([bytesOfBase64(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Texels of `width` columns: {data, width, height, depth}, value v of Gaussian i in layer v >> 2, channel v & 3. */
function texels(bytes, ArrayType, nValues, n, width) {
  const size = ArrayType.BYTES_PER_ELEMENT;
  const height = Math.ceil(n / width);
  const depth = Math.ceil(nValues / 4);
  const data = new ArrayType(width * height * depth * 4);
  const out = new Uint8Array(data.buffer);
  const stride = nValues * n;
  for (let v = 0; v < nValues; v++) {
    const first = (v >> 2) * width * height;
    for (let i = 0; i < n; i++) {
      const to = ((first + i) * 4 + (v & 3)) * size;
      for (let b = 0; b < size; b++) out[to + b] = bytes[b * stride + v * n + i];
    }
  }
  return { data, width, height, depth };
}

/** {exact, values}: texels of x, y, z, opacity (Float32Array) and of the rest (Uint16Array, halves). */
export function tables(bytes, layout, width = 1024) {
  const n = layout.n_gaussians;
  const nValues =
    7 + 3 * layout.sh_count + 6 * layout.n_fields + 3 * layout.light_count * layout.n_lights;
  const expected = 16 * n + 2 * nValues * n;
  if (bytes.length !== expected) throw new Error(`the scene has ${bytes.length} bytes, expected ${expected}`);
  return {
    exact: texels(bytes.subarray(0, 16 * n), Float32Array, 4, n, width),
    values: texels(bytes.subarray(16 * n), Uint16Array, nValues, n, width),
  };
}
