// Compare the law with what Python answered: node check.mjs
import { readFileSync } from "node:fs";
import { act, reset } from "./law.mjs";

const rows = readFileSync(new URL("vector.csv", import.meta.url), "utf8").trim().split("\n").map((line) => line.split(",").map(Number));
let m, before, worst = 0;
for (const [run, ...y] of rows) {
    if (run !== before) m = reset();
    before = run;
    const apart = Math.abs(act(m, y.slice(0, 6)) - y[6]);
    if (!(apart <= worst)) worst = apart;
}
console.log(`$${rows.length} forces, at most $${worst.toPrecision(3)} N apart, ${allowed} N allowed`);
process.exit(rows.length > 0 && worst <= ${allowed} ? 0 : 1);
