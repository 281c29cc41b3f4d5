// A board's line as TCP on localhost.

import { createServer } from 'node:net';

// One client at a time; the newest takes the place of the one before. Gives back what sends bytes to it, or hangs up.
export function listen(port, name, took, came = () => {}, went = () => {}) {
  let client;
  const server = createServer((socket) => {
    client?.destroy();
    client = socket.setNoDelay(true);
    came();
    socket.on('data', took).on('error', () => {}).on('close', () => { if (client === socket) { client = undefined; went(); } });
  });
  server.listen(port, '127.0.0.1', () => process.stdout.write(`${name} on socket://127.0.0.1:${server.address().port}\n`));
  const send = (bytes) => { if (client && bytes.length) client.write(bytes); };
  send.hangUp = () => client?.destroy();
  return send;
}
