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
      refuse("The upload failed: is narx-sym still running?");
    } finally {
      title.textContent = before;
    }
  }
  // The first screen stands in a frame of its own, which is fetched when its place is there; "Add" is pressed in it.
  const framed = new Map();
  async function frame(el) {
    const [{ default: live }, answer] = await Promise.all([import("/live.js"), fetch(el.dataset.live)]);
    const page = await answer.text();
    if (!answer.ok) refuse(page);
    else framed.set(el, live.render({ el, model: { get: () => page, set: (name, value) => name === "added" && value && emitEvent("add", value), save_changes() {} } }));
  }
  // While effects are searched, the frame shows the best by now.
  window.tellFrame = (removed) => document.querySelector("[data-live] iframe")?.contentWindow.postMessage({ removed }, "*");
  new MutationObserver(() => {
    for (const [el, end] of framed) if (!el.isConnected) { end(); framed.delete(el); }
    for (const el of document.querySelectorAll("[data-live]:not([data-known])")) { el.dataset.known = ""; frame(el); }
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
