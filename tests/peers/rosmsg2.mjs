// npm's @foxglove/rosmsg2-serialization, unmodified: node rosmsg2.mjs FOLDER < messages
// FOLDER: where node_modules is. Reads a JSON list of {definition, bytes}, and prints the decoded messages as JSON.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const require = createRequire(`${process.argv[2]}/`);
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const plain = (value) => {
  if (typeof value === "bigint") return Number(value);
  if (ArrayBuffer.isView(value)) return Array.from(value, plain);
  if (Array.isArray(value)) return value.map(plain);
  if (value === null || typeof value !== "object") return value;
  // The library renames the second field of a time.
  const entries = Object.entries(value).map(([key, each]) => [key === "nsec" ? "nanosec" : key, plain(each)]);
  return Object.fromEntries(entries);
};

const messages = JSON.parse(readFileSync(0, "utf8"));
const decoded = messages.map(({ definition, bytes }) => {
  const reader = new MessageReader(parse(definition, { ros2: true }));
  return plain(reader.readMessage(Buffer.from(bytes, "hex")));
});
console.log(JSON.stringify(decoded));
