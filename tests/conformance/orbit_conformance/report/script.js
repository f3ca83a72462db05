// Links into a closed section open it; buttons play a task's videos together and open all details of a section.
function reveal() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (target instanceof HTMLDetailsElement) target.open = true;
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
