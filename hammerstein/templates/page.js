"use strict";
// Tables sort by a click on a header and filter by words. Without scripts they are as they are.
const number = text => /^[\s(<]*-?[\d.]/.test(text) ? parseFloat(text.replace(/^[\s(<]+/, "")) : NaN;
const compare = (a, b) => {
  const x = number(a), y = number(b);
  return isNaN(x) && isNaN(y) ? a.localeCompare(b) : isNaN(x) ? 1 : isNaN(y) ? -1 : x - y;
};
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      heads.forEach(other => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.rows].sort((a, b) => compare(a.cells[column].textContent, b.cells[column].textContent));
      body.append(...(down ? rows.reverse() : rows));
    });
  });
}
const filters = (items, place, words) => {
  const label = document.createElement("label"), input = document.createElement("input");
  label.className = "filter";
  input.type = "search";
  label.append(words, input);
  place.before(label);
  input.addEventListener("input", () => {
    const wanted = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const item of items()) item.hidden = !wanted.every(word => item.textContent.toLowerCase().includes(word));
  });
};
for (const table of document.querySelectorAll("table.sortable"))
  if (table.tBodies[0].rows.length > 12) filters(() => table.tBodies[0].rows, table.parentElement, "Only rows with");
const cards = document.querySelectorAll(".card");
if (cards.length) filters(() => cards, cards[0].closest("section"), "Search");
