// Links into closed sections open them; buttons play a task's videos together and open all details of a section.
function reveal() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  // A link may lead into a fold within a fold: each has to be open before the target has a place to scroll to.
  for (let fold = target?.closest("details"); fold; fold = fold.parentElement?.closest("details")) fold.open = true;
  target?.scrollIntoView();
}
addEventListener("hashchange", reveal);
reveal();
for (const button of document.querySelectorAll("button[data-play]")) {
  button.addEventListener("click", () => {
    for (const video of document.getElementById(button.dataset.play).querySelectorAll("video")) {
      video.currentTime = 0;
      video.play();
    }
  });
}
for (const button of document.querySelectorAll("button[data-open]")) {
  button.addEventListener("click", () => {
    const all = [...document.getElementById(button.dataset.open).querySelectorAll("details")];
    const open = !all.every((one) => one.open);
    for (const one of all) one.open = open;
  });
}
