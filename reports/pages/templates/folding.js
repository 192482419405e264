"use strict";
(() => {
  const parts = [...document.querySelectorAll("details")];

  // Where the browser does not do it by itself: a link into a folded part opens it.
  function reveal() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (let node = target; node; node = node.parentElement) if (node.localName === "details") node.open = true;
    if (target) target.scrollIntoView();
  }
  addEventListener("hashchange", reveal);
  if (location.hash) reveal();

  // Print shows what is folded, also in browsers whose styles cannot open it.
  let folded = [];
  addEventListener("beforeprint", () => { folded = parts.filter((part) => !part.open); for (const part of folded) part.open = true; });
  addEventListener("afterprint", () => { for (const part of folded) part.open = false; });

  for (const button of document.querySelectorAll("button[data-fold]")) {
    const open = button.dataset.fold === "open";
    button.addEventListener("click", () => { for (const part of parts) part.open = open; });
    button.closest("[hidden]")?.removeAttribute("hidden");
  }

  // The contents mark the last part whose heading has passed the top of the window.
  const sectionOf = (link) => document.getElementById(decodeURIComponent(link.hash.slice(1)))?.closest("section");
  const links = [...document.querySelectorAll('nav a[href^="#"]')].filter(sectionOf);
  const marks = links.map(sectionOf);
  let now = null, asked = false;
  function mark() {
    asked = false;
    const below = innerHeight / 4, bottom = innerHeight + scrollY >= document.documentElement.scrollHeight - 2;
    let place = -1;
    marks.forEach((section, k) => { if (section.getBoundingClientRect().top <= below) place = k; });
    if (bottom && scrollY > 0) place = marks.length - 1;
    const link = links[Math.max(place, 0)];
    if (!link || link === now) return;
    now?.removeAttribute("aria-current");
    link.setAttribute("aria-current", "location");
    const list = link.closest("ol");
    if (list.scrollWidth > list.clientWidth) list.scrollTo({ left: link.offsetLeft - list.offsetLeft - 24 });
    now = link;
  }
  addEventListener("scroll", () => { if (!asked) { asked = true; requestAnimationFrame(mark); } }, { passive: true });
  addEventListener("resize", mark);
  mark();

  // What neither scrolls nor tells values is no stop of the tab key.
  const boxes = [...document.querySelectorAll('[role="group"][tabindex]')].filter((box) => !box.closest("[data-panels]"));
  const watch = new ResizeObserver((seen) => {
    for (const { target } of seen) if (target.clientWidth) target.tabIndex = target.scrollWidth > target.clientWidth ? 0 : -1;
  });
  for (const box of boxes) watch.observe(box);
})();
