// Checks pages as a reader meets them: node check.mjs [--reports PAGE...] [--site PAGE...]
//
// Each page is opened in a headless browser at two widths, light and dark (there for its contrasts). Everything that
// axe-core finds, everything that is wider than the window, every complaint of the browser and every request is a finding;
// so is what the HTML checker of the W3C says. Of reports, besides: their size, that links open the folded part in which their target lies, and that
// print shows what is folded. Ends with 1 where there is a finding.
import { execFileSync, spawnSync } from "node:child_process";
import { readFileSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { availableParallelism } from "node:os";
import { extname, join, relative, resolve } from "node:path";
import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";

const require = createRequire(import.meta.url);
const AXE = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const VNU = require.resolve("vnu-jar/build/dist/vnu.jar");
const LARGEST_REPORT = 1e6; // bytes
const SITE = resolve("out/docs"); // served, as a reader of the site has it
const TYPES = { ".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml", ".json": "application/json" };
const WIDTHS = [390, 1280];
const SCHEMES = ["light", "dark"];

function asked(words) {
  const pages = [];
  let kind = "report";
  for (const word of words) {
    if (word === "--reports") kind = "report";
    else if (word === "--site") kind = "site";
    else pages.push({ kind, path: resolve(word), name: word });
  }
  return pages;
}

function browserPath() {
  const found = spawnSync("sh", ["-c", "command -v chromium || command -v chromium-browser || command -v google-chrome"]);
  const path = found.stdout.toString().trim();
  if (!path) throw new Error("no browser: install the Debian package chromium");
  return path;
}

function served() {
  const server = createServer((request, answer) => {
    const path = join(SITE, decodeURIComponent(new URL(request.url, "http://localhost").pathname));
    try {
      const content = readFileSync(path);
      answer.writeHead(200, { "content-type": TYPES[extname(path)] ?? "application/octet-stream" }).end(content);
    } catch {
      answer.writeHead(404).end();
    }
  });
  return new Promise((done) => server.listen(0, "127.0.0.1", () => done(server)));
}

function address(page) {
  if (page.kind === "report") return pathToFileURL(page.path).href;
  return `${origin}/${relative(SITE, page.path)}`;
}

// ---- in the page

function unfold() {
  for (const part of document.querySelectorAll("details")) part.open = true;
}

// Scripts of the page see new sizes with the next frame.
async function settle() {
  for (let k = 0; k < 2; k++) await new Promise(requestAnimationFrame);
}

function wider() {
  const root = document.documentElement;
  if (root.scrollWidth <= root.clientWidth) return [];
  const scrolls = (node) => {
    for (let up = node.parentElement; up && up !== document.body; up = up.parentElement) {
      if (["auto", "scroll", "hidden", "clip"].includes(getComputedStyle(up).overflowX)) return true;
    }
    return false;
  };
  const over = [...document.body.querySelectorAll("*")].filter(
    (node) => node.getBoundingClientRect().right > root.clientWidth + 1 && !scrolls(node),
  );
  return [`the page is ${root.scrollWidth} px wide: ${over.slice(0, 3).map((node) => node.outerHTML.slice(0, 120)).join(" | ")}`];
}

function facts() {
  const timing = performance.getEntriesByType("navigation")[0];
  return {
    nodes: document.querySelectorAll("*").length,
    milliseconds: Math.round(timing.loadEventEnd),
    height: document.documentElement.scrollHeight,
  };
}

// Elements of folded parts that are not drawn.
function hidden() {
  const inside = [...document.querySelectorAll("details :is(td, th, p, li, dd, svg, pre)")];
  return inside.filter((node) => !node.checkVisibility() || node.getBoundingClientRect().height === 0).length;
}

async function unopened() {
  const found = [];
  for (const link of document.querySelectorAll('a[href^="#"]')) {
    const target = document.getElementById(decodeURIComponent(link.hash.slice(1)));
    const chain = [];
    for (let up = target?.parentElement; up; up = up.parentElement) if (up.localName === "details") chain.push(up);
    if (target?.localName === "details") chain.push(target);
    if (!target) found.push(`${link.hash} leads nowhere`);
    if (!chain.length) continue;
    for (const part of chain) part.open = false;
    link.click();
    await new Promise((done) => setTimeout(done, 60));
    if (chain.some((part) => !part.open)) found.push(`${link.hash} lies in a folded part, which its link does not open`);
  }
  return found;
}

// ---- one page

function told(violation) {
  const places = violation.nodes.map((node) => `      ${node.target.join(" ")}  ${node.html.slice(0, 140)}`);
  const shown = places.slice(0, 4).join("\n") + (places.length > 4 ? `\n      and ${places.length - 4} more` : "");
  return `axe ${violation.id} (${violation.impact}): ${violation.help}\n${shown}`;
}

// A tab on a page, and what the browser says and asks for while it is looked at.
async function opened(browser, page) {
  const context = await browser.newContext({ viewport: { width: WIDTHS[0], height: 900 } });
  const tab = await context.newPage();
  const own = address(page);
  const findings = [];
  const requests = new Set();
  tab.on("console", (message) => {
    const { url } = message.location();
    if (url.endsWith("/favicon.ico")) return; // asked for by the browser, not by the page
    if (["error", "warning"].includes(message.type())) findings.push(`the browser says: ${message.text()} ${url}`);
  });
  tab.on("pageerror", (error) => findings.push(`a script fails: ${error.message}`));
  tab.on("request", (request) => {
    const url = request.url();
    if (url === own || /^(data|blob):/.test(url)) return;
    requests.add(url);
    if (page.kind === "report" || !url.startsWith(origin)) findings.push(`a request for ${url}`);
  });
  await tab.goto(own, { waitUntil: "load" });
  const measured = await tab.evaluate(facts);
  return { context, tab, findings, requests, measured };
}

async function accessible(tab, rules) {
  const options = rules ? { runOnly: rules } : {};
  const { violations } = await tab.evaluate((given) => axe.run({ resultTypes: ["violations"], ...given }), options);
  return violations.map(told);
}

// What holds of a page with its folded parts folded.
async function folded(tab) {
  const findings = await tab.evaluate(unopened);
  await tab.reload({ waitUntil: "load" });
  await tab.emulateMedia({ media: "print" });
  const lost = await tab.evaluate(hidden);
  if (lost) findings.push(`print leaves out ${lost} elements of folded parts`);
  await tab.emulateMedia({ media: "screen" });
  await tab.evaluate(AXE);
  return [...findings, ...(await accessible(tab))];
}

async function seen(browser, page) {
  const { context, tab, findings, requests, measured } = await opened(browser, page);
  const height = {};
  if (page.kind === "report") findings.push(...(await folded(tab)));
  else await tab.evaluate(AXE);
  for (const width of WIDTHS) {
    await tab.setViewportSize({ width, height: 900 });
    height[width] = (await tab.evaluate(facts)).height;
  }
  await tab.evaluate(unfold);
  for (const width of WIDTHS) {
    await tab.setViewportSize({ width, height: 900 });
    for (const scheme of SCHEMES) {
      await tab.emulateMedia({ colorScheme: scheme });
      await tab.evaluate(settle);
      const rules = scheme === "light" ? null : ["color-contrast"];
      const found = [...(await tab.evaluate(wider)), ...(await accessible(tab, rules))];
      findings.push(...found.map((text) => `${width} px, ${scheme}: ${text}`));
    }
  }
  await context.close();
  const bytes = statSync(page.path).size;
  if (page.kind === "report" && bytes >= LARGEST_REPORT) findings.push(`${bytes} bytes; a report is below ${LARGEST_REPORT}`);
  const { nodes, milliseconds } = measured;
  return { findings, bytes, requests: requests.size, nodes, milliseconds, height: height[WIDTHS.at(-1)] };
}

function validated(pages) {
  const options = ["-jar", VNU, "--format", "json", "--stdout", "--exit-zero-always", ...pages.map((page) => page.path)];
  const { messages } = JSON.parse(execFileSync("java", options, { maxBuffer: 1 << 28 }).toString());
  const byPage = new Map(pages.map((page) => [pathToFileURL(page.path).href.replace("file:///", "file:/"), page]));
  const findings = new Map(pages.map((page) => [page, new Set()]));
  for (const message of messages.filter(({ type, subType }) => type !== "info" || subType)) {
    const page = byPage.get(message.url?.replace("file:///", "file:/"));
    const extract = (message.extract ?? "").replaceAll("\n", " ").slice(0, 100);
    const kind = message.subType ?? message.type;
    const text = `html ${kind}, line ${message.lastLine}: ${message.message}  ${extract}`;
    if (page) findings.get(page).add(text);
    else throw new Error(text);
  }
  return findings;
}

// Some tabs at a time; pages are told in the order in which they were named.
async function each(pages, look) {
  const found = new Array(pages.length);
  let next = 0;
  const work = async () => {
    for (let k = next++; k < pages.length; k = next++) found[k] = await look(pages[k]);
  };
  await Promise.all(Array.from({ length: Math.min(availableParallelism(), 4) }, work));
  return found;
}

function line(found, name) {
  const columns = [[found.bytes, 8], [found.requests, 9], [found.nodes, 6], [found.milliseconds, 8], [found.height, 14]];
  return `${columns.map(([value, width]) => String(value).padStart(width)).join(" ")}  ${name}`;
}

const pages = asked(process.argv.slice(2));
if (!pages.length) throw new Error("no pages: node check.mjs [--reports PAGE...] [--site PAGE...]");
const html = validated(pages);
const server = await served();
const origin = `http://127.0.0.1:${server.address().port}`;
const browser = await chromium.launch({ executablePath: browserPath(), args: ["--no-sandbox", "--disable-gpu"] });
const looked = await each(pages, (page) => seen(browser, page));
await browser.close();
server.close();
let total = 0;
console.log("   bytes  requests  nodes  load ms  px at 1280 px  page");
for (const [k, page] of pages.entries()) {
  const findings = [...new Set([...looked[k].findings, ...html.get(page)])];
  console.log([line(looked[k], page.name), ...findings.map((text) => `    ${text}`)].join("\n"));
  total += findings.length;
}
const things = (many, what) => `${many} ${what}${many === 1 ? "" : "s"}`;
console.log(total ? things(total, "finding") : `no findings on ${things(pages.length, "page")}`);
process.exitCode = total ? 1 : 0;
