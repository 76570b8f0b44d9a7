// The page stands in a frame of its own: its ids, its colours and its scripts meet nothing of the notebook.
function render({model, el}) {
  const frame = document.createElement("iframe");
  frame.setAttribute("sandbox", "allow-scripts allow-downloads");
  frame.title = "What was found: switches, loop, portrait, and sliders of every parameter";
  frame.style = "width: 100%; height: 60rem; border: 0";
  frame.srcdoc = model.get("page");
  const heard = event => {
    if (event.source !== frame.contentWindow) return;
    frame.style.height = `${event.data.height}px`;
    for (const name of ["chosen", "rms", "theta", "added"]) model.set(name, event.data[name]);
    model.save_changes();
  };
  window.addEventListener("message", heard);
  el.append(frame);
  return () => window.removeEventListener("message", heard);
}
export default {render};
