"use strict";
for (const region of document.querySelectorAll(".region")) {
  const svg = region.querySelector("svg");
  const tip = region.querySelector(".tip");
  const runs = [...svg.querySelectorAll(".run")];
  const buttons = [...region.querySelectorAll(".names button")];
  const near = 9; // pixels within which runs are shown together
  const shownAtOnce = 3;
  let held = null; // the group whose name was pressed

  for (const run of runs) {
    const title = run.querySelector("title");
    run.said = title.textContent;
    title.remove(); // the browser's own would lie over ours
  }

  const centre = (run) => {
    const box = run.querySelector("circle").getBoundingClientRect();
    return { x: box.left + box.width / 2, y: box.top + box.height / 2 };
  };

  const pick = (chosen) => {
    for (const element of svg.querySelectorAll("[data-group]")) element.classList.toggle("picked", chosen(element));
    region.classList.toggle("picking", svg.querySelector(".picked") !== null);
  };
  const pickHeld = () => pick((element) => held !== null && element.dataset.group === held);

  const show = (found) => {
    if (!found.length) return hide();
    tip.replaceChildren();
    for (const run of found.slice(0, shownAtOnce)) {
      const [name, ...others] = run.said.split("\n");
      const paragraph = document.createElement("p");
      const strong = document.createElement("strong");
      strong.textContent = name;
      paragraph.append(strong, "\n" + others.join("\n"));
      tip.append(paragraph);
    }
    if (found.length > shownAtOnce) {
      const more = document.createElement("p");
      more.textContent = `and ${found.length - shownAtOnce} more here`;
      tip.append(more);
    }
    tip.hidden = false;
    const frame = region.getBoundingClientRect();
    const at = centre(found[0]);
    const left = Math.min(at.x - frame.left + 14, frame.width - tip.offsetWidth);
    const fits = at.y + 14 + tip.offsetHeight <= window.innerHeight;
    tip.style.left = `${Math.max(0, left)}px`;
    tip.style.top = `${at.y - frame.top + (fits ? 14 : -14 - tip.offsetHeight)}px`;
    pick((element) => found.includes(element));
  };
  const hide = () => {
    tip.hidden = true;
    pickHeld();
  };

  const nearest = (event) => {
    const distances = runs.map((run) => {
      const at = centre(run);
      return [Math.hypot(at.x - event.clientX, at.y - event.clientY), run];
    });
    const open = distances.filter(([, run]) => held === null || run.dataset.group === held);
    return open
      .filter(([distance]) => distance <= near)
      .sort(([a], [b]) => a - b)
      .map(([, run]) => run);
  };
  svg.addEventListener("pointermove", (event) => show(nearest(event)));
  svg.addEventListener("pointerdown", (event) => show(nearest(event)));
  svg.addEventListener("pointerleave", hide);
  svg.addEventListener("focusout", hide);
  runs.forEach((run, index) => {
    run.addEventListener("focus", () => run.matches(":focus-visible") && show([run]));
    run.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (event.key === "Escape") hide();
      if (step === undefined) return;
      event.preventDefault();
      const next = runs[(index + step + runs.length) % runs.length];
      run.tabIndex = -1;
      next.tabIndex = 0;
      next.focus();
    });
  });

  for (const button of buttons) {
    const chosen = (element) => element.dataset.group === button.dataset.group;
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("pointerenter", () => pick(chosen));
    button.addEventListener("pointerleave", pickHeld);
    button.addEventListener("click", () => {
      held = held === button.dataset.group ? null : button.dataset.group;
      for (const other of buttons) other.setAttribute("aria-pressed", String(other.dataset.group === held));
      pickHeld();
    });
  }
}
