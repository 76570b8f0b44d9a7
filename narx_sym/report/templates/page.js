// What every page of parts does: it copies, and opens what a link leads to.
document.addEventListener("click", async event => {
  const button = event.target.closest("button[data-copy]");
  if (!button) return;
  const text = document.getElementById(button.dataset.copy).textContent;
  try {
    await navigator.clipboard.writeText(text);
  } catch {  // a page that was opened from disk
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = before; }, 5000);
});
// On paper nothing can be scrolled: a long formula becomes smaller.
const PAPER = 680;  // width of what is printed of a page of A4 or Letter [px]
const paper = window.matchMedia("print");
paper.addEventListener("change", () => {
  for (const math of document.querySelectorAll(".equation > math")) {
    math.style.fontSize = "";
    if (paper.matches) math.style.fontSize = `${Math.min(1, PAPER / math.getBoundingClientRect().width)}em`;
  }
});
const reveal = () => document.getElementById(location.hash.slice(1))?.querySelector("details")?.setAttribute("open", "");
window.addEventListener("hashchange", reveal);
reveal();
