/** An xz stream, and the bytes that it holds. */

export const STREAM =
  "/Td6WFoAAATm1rRGAgAhARYAAAB0L+Wj4BSzAS9dAAAAUrgPwluI8BxehUIjyG75an6Opz3ivq6DHQVpAc5lBbOQi1e9WUTlMwz5iWZeIQxu6PKmfWoEMKQNulmTEZktNvUMn/VqtXcM/ArPYAPJLyJHTDh7uACUs1AqxZFWYQwBDKspNf1Zx4ImY7Ojsfd4ocF+Qk84zhjtI8NerY8iuLAqC4ljOkYlkjG9bhO1+CdUKK6/JpRUaLxwalXQwnHZh5WGdQte4QUxuVBVczXK76K/29RGI9vf1Ha1LHLPyeMwNO7xjqLOO2kaqCDllZjhyMXWpBtlUbKKOiXn2kt/SbF64vktzNEv8+3iLY7vx+dbe8nEQaTQzCuHX72WHQLCUVaYTJnkt8wTj6zrXKyICSPzI9HL0rQM4GsK9fdHxgGadg2Oypdmy3zSYqTiAAAAiuiF9Auw0WMAAcsCtCkAAGjNNmexxGf7AgAAAAAEWVo=";

export const BYTES = Uint8Array.from([
  ...Array.from({ length: 3000 }, (_, i) => (i * i) % 251),
  ...new TextEncoder().encode("abcabcabc".repeat(200)),
  ...new Uint8Array(500),
]);
