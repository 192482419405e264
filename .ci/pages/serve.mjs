// Walks through the page of `dqforge serve` by the keyboard alone: node serve.mjs ADDRESS FOLDER
//
// From an empty form to the VESC file of a hub motor; axe-core looks at every state at two widths, light and dark.
import { execFileSync, spawnSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const [address, folder] = process.argv.slice(2);
const require = createRequire(import.meta.url);
const AXE = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const SHEET = [
  ["sheet-pole-pairs", "15"], ["sheet-kv", "60 rpm/V"], ["sheet-v-dc", "48 V"], ["sheet-max-current", "40 A rms"],
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

await page.goto(address);
await look("the empty form");
for (const [id, text] of SHEET) {
  await reach(id);
  await page.keyboard.type(text);
}
await page.keyboard.press("Enter");
await page.waitForSelector("#work:not([hidden])");
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
