// Offer corrections of what is chosen on the map, and compose the command that makes them (wclm correct)
(() => {
  const panel = document.getElementById("correct");
  if (!panel) return; // the map cannot be corrected
  const svg = document.querySelector("#map svg"), slider = document.querySelector(".time input");
  const offers = panel.querySelector(".offers"), places = panel.querySelector(".places");
  const result = panel.querySelector(".command"), text = result.querySelector(".composed");
  const corrections = new Set();
  const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
  const folder = decodeURIComponent(location.pathname).replace(/\/[^/]*$/, "");
  const directory = location.protocol === "file:" ? quoted(folder) : "DIRECTORY";

  const showCommand = () => {
    result.hidden = !corrections.size;
    text.textContent = ["wclm correct", directory, ...corrections].join(" ");
  };
  const add = (option) => {
    corrections.add(option);
    showCommand();
  };
  const offer = (label, option) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.addEventListener("click", () => add(option));
    offers.append(button);
  };

  let lastWall = null;
  svg.addEventListener("chosen", ({ detail: element }) => {
    offers.replaceChildren();
    const { wall, loop } = element.dataset;
    if (wall) {
      offer(`Wall ${wall} is no wall`, `--delete-wall ${wall}`);
      if (lastWall && lastWall !== wall) offer(`Walls ${lastWall} and ${wall} are one`, `--tie ${lastWall},${wall}`);
    }
    lastWall = wall ?? null;
    if (!loop) return;
    if (element.classList.contains("accepted")) offer(`Loop ${loop} is wrong`, `--forbid-loop ${loop}`);
    else offer(`Loop ${loop} is right`, `--close ${loop}`);
  });

  // Two places on the path are one: the first is marked, then the slider moved to the second one
  const [mark, join] = places.querySelectorAll("button");
  const stamp = () => `${(Number(places.dataset.start) + Number(slider.value)).toFixed(1)}s`;
  let first = null;
  mark.addEventListener("click", () => {
    first = stamp();
    join.textContent = `It is the place of ${document.querySelector(".time output").textContent}`;
    join.hidden = false;
  });
  join.addEventListener("click", () => {
    if (first !== stamp()) add(`--close ${first},${stamp()}`);
  });

  const [copy, clear] = result.querySelectorAll("button");
  copy.addEventListener("click", () => {
    getSelection().selectAllChildren(text); // to be copied by hand where a page may not use the clipboard
    navigator.clipboard?.writeText(text.textContent).catch(() => {});
  });
  clear.addEventListener("click", () => {
    corrections.clear();
    showCommand();
  });
})();
