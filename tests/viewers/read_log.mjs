// Reads a log as any program of Node.js would, and prints each message as a line of JSON.
// Usage: node read_log.mjs LOG

import { createHash } from "node:crypto";
import { open } from "node:fs/promises";

import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const file = await open(process.argv[2]);
const log = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const text = new TextDecoder();
const readers = new Map();
for (const schema of log.schemasById.values()) {
  if (schema.encoding === "ros2msg") {
    readers.set(schema.id, new MessageReader(parse(text.decode(schema.data), { ros2: true })));
  }
}

for await (const record of log.readMessages()) {
  const channel = log.channelsById.get(record.channelId);
  const reader = readers.get(channel.schemaId);
  const line = {
    topic: channel.topic,
    log_ns: String(record.logTime),
    message: reader ? reader.readMessage(record.data) : record.data,
  };
  process.stdout.write(JSON.stringify(line, plain) + "\n");
}
await file.close();

// What JSON has no word for, as plain_message.py writes it.
function plain(_, value) {
  if (value instanceof Uint8Array) {
    if (value.length === 0) return []; // as other readers give an empty list
    return { bytes: value.length, sha256: createHash("sha256").update(value).digest("hex") };
  }
  if (ArrayBuffer.isView(value)) {
    return Array.from(value);
  }
  if (typeof value === "bigint") {
    return Number(value);
  }
  return typeof value === "number" && !Number.isFinite(value) ? String(value) : value;
}
