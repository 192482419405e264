// Walks through the page of `dqforge serve` by the keyboard alone: node serve.mjs ADDRESS FOLDER
//
// From an empty form to the VESC file of a hub motor, of which the magnet flux comes from a capture; axe-core looks at every
// state at two widths, light and dark. Files are dropped on their zones, and chosen in their fields, which Tab reaches.
import { execFileSync, spawnSync } from "node:child_process";
import { mkdirSync, readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, folder] = process.argv.slice(2);
const require = createRequire(import.meta.url);
const AXE = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const SHEET = [
  ["sheet-pole-pairs", "15"], ["sheet-v-dc", "48 V"], ["sheet-max-current", "40 A rms"],
  ["sheet-resistance", "100 mOhm line-to-line"], ["sheet-inductance", "200 uH line-to-line"],
];
const findings = [];
const browser = await chromium.launch({
  executablePath: spawnSync("sh", ["-c", "command -v chromium"]).stdout.toString().trim(), args: ["--no-sandbox"],
});
const context = await browser.newContext({ acceptDownloads: true, bypassCSP: true }); // axe is put into the page
const page = await context.newPage();
page.on("console", (message) => { if (message.type() === "error") findings.push(`the browser says: ${message.text()}`); });
page.on("pageerror", (error) => findings.push(`the page fails: ${error.message}`));

async function reach(id) {
  for (let presses = 0; presses < 400; presses += 1) {
    if (await page.evaluate((wanted) => document.activeElement.id === wanted || document.activeElement.dataset?.kind === wanted, id)) return;
    await page.keyboard.press("Tab");
  }
  throw new Error(`no key leads to ${id}`);
}
async function look(state) {
  for (const width of [390, 1280]) {
    for (const colorScheme of ["light", "dark"]) {
      await page.setViewportSize({ width, height: 900 });
      await page.emulateMedia({ colorScheme });
      await page.evaluate(AXE);
      const { violations } = await page.evaluate(() => axe.run({ resultTypes: ["violations"] }));
      for (const one of violations) findings.push(`${state}, ${width} px, ${colorScheme}: axe ${one.id}: ${one.nodes[0].html}`);
      const wide = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      if (wide > 0) findings.push(`${state}: ${wide} px wider than ${width} px`);
    }
  }
}
const idle = () => page.waitForFunction(() => document.getElementById("busy").textContent === "", null, { timeout: 120000 });

mkdirSync(folder, { recursive: true });
await page.goto(address);
await look("the empty form");
for (const [id, text] of SHEET) {
  await reach(id);
  await page.keyboard.type(text);
}

// A file that is no capture, dropped: refused in one line, nothing kept. Then the capture, chosen in the field.
const samples = Array.from({ length: 2000 }, (_, k) => k * 2e-5);
const volts = (time, phase) => (3 * Math.cos(2 * Math.PI * 50 * time - (phase * 2 * Math.PI) / 3)).toFixed(6).replace(".", ",");
const capture = ["time_s;e_a_V;e_b_V;e_c_V", ...samples.map((time) => [time.toFixed(6).replace(".", ","), ...[0, 1, 2].map((k) => volts(time, k))].join(";"))].join("\n");
async function drop(id, name, content) {
  await page.evaluate(([wanted, called, text]) => {
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([text], called));
    const zone = document.getElementById(wanted).closest(".drop");
    for (const kind of ["dragover", "drop"]) zone.dispatchEvent(new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
  }, [id, name, content]);
}
await drop("capture", "notes.csv", "\u0000\u0001\u0002 no capture");
if (!(await page.evaluate(() => document.getElementById("capture-taken").textContent)).includes("notes.csv")) findings.push("the zone does not say what was dropped");
await reach("sheet-pole-pairs");
await page.keyboard.press("Enter");
await page.waitForSelector("#problem:not([hidden])");
const said = await page.evaluate(() => document.getElementById("problem").textContent);
if (!said.startsWith("notes.csv") || said.includes("\n")) findings.push(`no line on a file that is no capture: ${said}`);
await look("a file refused");
if (readdirSync(folder, { recursive: true }).length) findings.push("a refused file was kept");
await page.evaluate(() => document.activeElement.blur());
await reach("map");
await reach("capture");
await page.setInputFiles("#capture", { name: "scope (1).csv", mimeType: "text/csv", buffer: Buffer.from(capture) });
await reach("sheet-pole-pairs");
await page.keyboard.press("Enter");
await page.waitForSelector("#work:not([hidden])");
if (!(await page.evaluate(() => document.getElementById("said").textContent)).includes("magnet flux 9.549 mWb")) findings.push("nothing is said of the capture");
await idle();
await look("check");
await page.evaluate(() => document.activeElement.blur());
await reach("tune");
await page.keyboard.press("Enter");
await page.waitForSelector("#answer figure img");
await idle();
const numbers = await page.evaluate(() => [...document.querySelectorAll("#answer td")].filter((cell) => /^[-+]?\d.{0,40}$/.test(cell.textContent)).map((cell) => getComputedStyle(cell).whiteSpace));
if (!numbers.length || numbers.some((space) => space !== "nowrap")) findings.push("a cell with a number can be broken");
await look("tune");

// A bad value in each field: refused in words, and the file stays.
const kept = readFileSync(`${folder}/design.yaml`, "utf8");
const fields = await page.evaluate(() => [...document.querySelectorAll("#fields input:not([type=range])")].map((one) => one.id).filter((id) => id !== "field-name"));
for (const id of fields) {
  await page.evaluate((wanted) => document.getElementById(wanted).focus(), id);
  await page.keyboard.press("Control+A");
  await page.keyboard.type("-7 furlongs");
  await page.keyboard.press("Enter");
  await page.waitForSelector("#problem:not([hidden])");
  await page.reload();
  await page.waitForSelector("#work:not([hidden])");
  await idle();
}
if (readFileSync(`${folder}/design.yaml`, "utf8") !== kept) findings.push("a bad value reached the file");

// A slider by its keys: a live answer, then the file.
await page.evaluate(() => document.getElementById("slide-inverter.v_dc").focus());
await page.keyboard.press("ArrowRight");
await idle();
await page.waitForFunction(() => !document.getElementById("text").value.includes("v_dc: 48 V"));

await page.evaluate(() => { document.getElementById("target").value = "vesc"; document.activeElement.blur(); });
await reach("download");
const [download] = await Promise.all([page.waitForEvent("download", { timeout: 120000 }), page.keyboard.press("Enter")]);
const listed = execFileSync("python3", ["-m", "zipfile", "-l", await download.path()]).toString();
if (!listed.includes("_mcconf.xml")) findings.push(`no VESC file in the download: ${listed}`);
await browser.close();
for (const finding of new Set(findings)) console.log(finding);
console.log(`serve: ${fields.length} fields with a bad value, ${new Set(findings).size} findings`);
process.exit(findings.length ? 1 : 0);
