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
const reveal = () => document.getElementById(location.hash.slice(1))?.querySelector("details")?.setAttribute("open", "");
window.addEventListener("hashchange", reveal);
reveal();
