// Opens a page in headless Chromium without a network, and prints what it shows as JSON.
// Usage: node open_report.mjs CHROMIUM PAGE PICTURE

import { pathToFileURL } from "node:url";

import { chromium } from "playwright-core";

const [executablePath, page, picture] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const context = await browser.newContext({ viewport: { width: 1280, height: 900 }, offline: true });
const tab = await context.newPage();
const errors = [];
const requests = [];
tab.on("console", (message) => message.type() === "error" && errors.push(message.text()));
tab.on("pageerror", (error) => errors.push(String(error)));
tab.on("request", (request) => requests.push(request.url()));

await tab.goto(pathToFileURL(page).href, { waitUntil: "load" });
await tab.waitForFunction(() => [...document.querySelectorAll(".plotly-graph-div")].every((div) => div.data));
await tab.screenshot({ path: picture, fullPage: true });
const shown = await tab.evaluate(async () => {
  const pixels = async (source) => {
    const image = new Image();
    image.src = source;
    await image.decode();
    return image.naturalWidth * image.naturalHeight;
  };
  const sources = [...document.querySelectorAll("img, svg image")].map((image) => image.src ?? image.href.baseVal);
  return {
    text: document.body.innerText,
    overflow_px: document.documentElement.scrollWidth - window.innerWidth,
    figures: [...document.querySelectorAll(".plotly-graph-div")].map((div) => ({
      traces: div.data.length,
      marks: div.querySelectorAll("svg path, canvas").length,
      height_px: div.getBoundingClientRect().height,
    })),
    image_pixels: await Promise.all(sources.map(pixels)),
  };
});
await browser.close();
process.stdout.write(JSON.stringify({ ...shown, errors, requests }));
