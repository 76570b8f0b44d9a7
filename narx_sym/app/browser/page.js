// Files go to the server as they are: chosen with a click, or dropped.
(() => {
  const refuse = (text) => emitEvent("refused", text);
  async function send(input, file) {
    if (!file) return;
    const most = Number(input.dataset.limit);
    if (file.size > most) {
      refuse(`${file.name} has ${(file.size / 1e6).toFixed(1)} MB; at most ${most / 1e6} MB are taken.`);
      return;
    }
    const title = input.closest(".drop").querySelector(".what"), before = title.textContent;
    title.textContent = `Reading ${file.name} ...`;
    try {
      const target = `${input.dataset.to}?name=${encodeURIComponent(file.name)}`;
      const answer = await fetch(target, { method: "POST", body: file });
      if (!answer.ok) refuse(await answer.text());
    } catch (error) {
      refuse("The file did not arrive: is narx-sym still running?");
    } finally {
      title.textContent = before;
    }
  }
  // Pictures that can be zoomed are drawn when their places are there.
  window.narxDraw = (draw, left = 50) => {
    const there = document.querySelector(".report .plot");
    if (there && window.Bokeh) draw();
    else if (left) setTimeout(() => window.narxDraw(draw, left - 1), 100);
  };
  // The sliders stand in a frame of their own, which is fetched when its place comes into sight.
  const framed = new Map();
  const inSight = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) if (isIntersecting) { inSight.unobserve(target); frame(target); }
  }, { rootMargin: "400px" });
  async function frame(el) {
    const [{ default: live }, answer] = await Promise.all([import("/live.js"), fetch(el.dataset.live)]);
    const page = await answer.text();
    if (!answer.ok) refuse(page);
    else framed.set(el, live.render({ el, model: { get: () => page, set() {}, save_changes() {} } }));
  }
  new MutationObserver(() => {
    for (const [el, end] of framed) if (!el.isConnected) { end(); framed.delete(el); }
    for (const el of document.querySelectorAll("[data-live]:not([data-known])")) { el.dataset.known = ""; inSight.observe(el); }
    for (const el of document.querySelectorAll("[data-drawn]:not([data-known])")) {
      el.dataset.known = "";
      import("/drawn.js").then(({ default: drawn }) => drawn(el));
    }
  }).observe(document.body, { childList: true, subtree: true });
  // Tabs: a click, or the arrows.
  const choose = (tab) => {
    for (const one of tab.parentElement.querySelectorAll("[role=tab]")) {
      const chosen = one === tab;
      one.setAttribute("aria-selected", String(chosen));
      one.tabIndex = chosen ? 0 : -1;
      document.getElementById(one.getAttribute("aria-controls")).hidden = !chosen;
    }
  };
  const tabOf = (event) => event.target.closest?.("[role=tab]");
  document.addEventListener("click", (event) => tabOf(event) && choose(tabOf(event)));
  document.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key], tab = tabOf(event);
    if (by && tab) {
      const all = [...tab.parentElement.querySelectorAll("[role=tab]")];
      const next = all[(all.indexOf(tab) + by + all.length) % all.length];
      choose(next);
      next.focus();
    }
    // In a field the keys belong to its text.
    if (!(event.ctrlKey || event.metaKey) || event.altKey || event.target.closest?.("input:not([type=radio]), textarea")) return;
    const key = event.key.toLowerCase(), what = key === "y" || (key === "z" && event.shiftKey) ? "redo" : key === "z" ? "undo" : "";
    if (!what) return;
    event.preventDefault();
    emitEvent(what, {});
  });
  // A candidate that is pointed at or has the focus is seen in the picture that stays.
  const preview = (event) => {
    const one = event.target.closest?.("[data-candidate]"), seen = document.querySelector(".seen");
    if (!seen) return;
    const lines = one ? [...seen.querySelectorAll(`[id$="-candidate_${one.dataset.candidate}"]`)] : [];
    for (const line of seen.querySelectorAll('[id*="-candidate_"]')) line.classList.toggle("on", lines.includes(line));
    const text = !one ? "" : lines.length ? `Dash-dotted: with ${one.dataset.name}.` : `There is no run of ${one.dataset.name} on these samples.`;
    const place = seen.querySelector(".previewed");
    if (place.textContent !== text) place.textContent = text;
  };
  for (const kind of ["pointerover", "focusin"]) document.addEventListener(kind, preview);
  document.addEventListener("click", async (event) => {
    const button = event.target.closest?.("button[data-copy]");
    if (!button) return;
    await navigator.clipboard.writeText(document.getElementById(button.dataset.copy).textContent);
    const before = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = before), 1500);
  });
  const inputOf = (event) => event.target.closest?.(".drop")?.querySelector("input[type=file]");
  document.addEventListener("change", (event) => {
    if (!event.target.matches?.("input[type=file][data-to]")) return;
    send(event.target, event.target.files[0]);
    event.target.value = "";
  });
  for (const kind of ["dragover", "dragleave", "drop"]) {
    document.addEventListener(kind, (event) => {
      event.preventDefault(); // a file dropped beside the field must not replace the page
      const input = inputOf(event);
      input?.closest(".drop").classList.toggle("over", kind === "dragover");
      if (kind === "drop" && input) send(input, event.dataTransfer.files[0]);
    });
  }
})();
// Letters on a canvas keep the colour that they were painted with.
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const { id } of (window.Bokeh?.documents ?? []).flatMap(d => d.roots())) Bokeh.index.get_by_id(id)?.request_paint();
});
