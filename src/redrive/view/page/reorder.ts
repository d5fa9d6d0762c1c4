// SPDX-License-Identifier: Apache-2.0
// Drags the rows of a list to another position, by their grips.

/** A grip for a row, which goes into it. */
export function grip(): HTMLElement {
  const made = document.createElement("span");
  made.className = "grip";
  made.textContent = "≡";
  made.title = "Drag to reorder";
  made.ariaHidden = "true"; // buttons do the same for the keyboard
  return made;
}

/** Calls `move` with a row's index and its index after it was dragged. Escape ends a drag. */
export function dragToReorder(list: HTMLElement, move: (from: number, to: number) => void): void {
  let dragged: Element | null = null;
  let to = 0;

  const clear = () => {
    for (const row of list.children) row.classList.remove("dragged", "drop-before", "drop-after");
  };
  const end = () => {
    dragged = null;
    clear();
  };

  list.addEventListener("pointerdown", (event) => {
    const target = event.target as Element;
    if (event.button !== 0 || !target.matches(".grip")) return;
    dragged = target.closest("li");
    if (!dragged) return;
    to = [...list.children].indexOf(dragged);
    list.setPointerCapture(event.pointerId);
    dragged.classList.add("dragged");
    event.preventDefault(); // selects no text
  });

  list.addEventListener("pointermove", (event) => {
    if (!dragged) return;
    if (!dragged.isConnected) return end(); // the list was made anew
    const others = [...list.children].filter((row) => row !== dragged);
    to = others.filter((row) => {
      const {top, height} = row.getBoundingClientRect();
      return event.clientY > top + height / 2;
    }).length;
    clear();
    dragged.classList.add("dragged");
    if (to < others.length) others[to].classList.add("drop-before");
    else others.at(-1)?.classList.add("drop-after");
  });

  list.addEventListener("pointerup", () => {
    const from = dragged?.isConnected ? [...list.children].indexOf(dragged) : to;
    end();
    if (from !== to) move(from, to);
  });
  list.addEventListener("pointercancel", end);
  document.addEventListener("keydown", ({key}) => {
    if (key === "Escape") end();
  });
}
