// Arrays in JSON: base64 of little-endian numbers.

/** Return the bytes of a base64 text. */
export function bytesOf(text: string): Uint8Array<ArrayBuffer> {
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let i = 0; i < characters.length; i++) {
    bytes[i] = characters.charCodeAt(i);
  }
  return bytes;
}

/** Return float32 numbers written as base64. */
export function floatsOf(text: string): Float32Array<ArrayBuffer> {
  return new Float32Array(bytesOf(text).buffer);
}

/** Return uint32 numbers written as base64. */
export function uint32Of(text: string): Uint32Array<ArrayBuffer> {
  return new Uint32Array(bytesOf(text).buffer);
}

/** Return uint16 numbers written as base64. */
export function uint16Of(text: string): Uint16Array<ArrayBuffer> {
  return new Uint16Array(bytesOf(text).buffer);
}

/** Return int16 numbers written as base64. */
export function int16Of(text: string): Int16Array<ArrayBuffer> {
  return new Int16Array(bytesOf(text).buffer);
}

/** Return float32 numbers as base64. */
export function base64Of(numbers: Float32Array): string {
  const bytes = new Uint8Array(numbers.buffer, numbers.byteOffset, numbers.byteLength);
  let characters = "";
  for (const byte of bytes) {
    characters += String.fromCharCode(byte);
  }
  return btoa(characters);
}
