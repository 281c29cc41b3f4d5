// What real silicon would not forgive.

export class Fault extends Error {}

export function fault(message) {
  throw new Fault(message);
}

const hex = (n) => '0x' + (n >>> 0).toString(16).padStart(8, '0');
export { hex };
