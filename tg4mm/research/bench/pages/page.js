// Tables sort by the column whose head is clicked: numbers as numbers, what has none last.
for (const table of document.querySelectorAll("figure.table table")) {
  const body = table.tBodies[0];
  const value = (row, i) => {
    const text = row.cells[i].textContent.trim();
    const number = Number(text.replace(/ ±.*/, "").replace(/,/g, "").replace("−", "-").replace(/%$/, ""));
    return text === "–" ? null : Number.isNaN(number) ? text : number;
  };
  [...table.tHead.rows[0].cells].forEach((head, i) => {
    head.classList.add("sortable");
    head.tabIndex = 0;
    const sort = () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows].map((row) => [value(row, i), row]);
      rows.sort(([a], [b]) => {
        if (a === null || b === null) return (a === null) - (b === null);
        const order = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
        return down ? -order : order;
      });
      body.append(...rows.map(([, row]) => row));
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(); });
  });
}
// The left picture ends where the edge stands.
for (const figure of document.querySelectorAll("figure.compare")) {
  const left = figure.querySelector('[data-side="left"]');
  const edge = figure.querySelector("[data-edge]");
  edge.addEventListener("input", () => {
    left.style.clipPath = `inset(0 ${100 - edge.value}% 0 0)`;
    left.parentElement.style.setProperty("--edge", `${edge.value}%`);
  });
  for (const pick of figure.querySelectorAll("[data-pick]")) {
    pick.addEventListener("change", () => {
      figure.querySelector(`[data-side="${pick.dataset.pick}"]`).src = pick.value;
    });
  }
}
