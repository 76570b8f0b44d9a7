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
    try {
      const target = `${input.dataset.to}?name=${encodeURIComponent(file.name)}`;
      const answer = await fetch(target, { method: "POST", body: file });
      if (!answer.ok) refuse(await answer.text());
    } catch (error) {
      refuse("The file did not arrive: is narx-sym still running?");
    }
  }
  // Pictures that can be zoomed are drawn when their places are there.
  window.narxDraw = (draw, left = 50) => {
    const there = document.querySelector(".report .plot");
    if (there && window.Bokeh) draw();
    else if (left) setTimeout(() => window.narxDraw(draw, left - 1), 100);
  };
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
