// What the server tells, and the files that it tells of.

// Listens to the server until the page is closed. `onScene` gets each scene that is new or has changed, `onTrouble` a
// text when the server is not heard, and null when it is heard again.
export function listen(onScene, onTrouble) {
  const events = new EventSource('/events');
  events.addEventListener('scene', (event) => onScene(JSON.parse(event.data)));
  events.addEventListener('told', () => onTrouble(null));
  // The browser goes on trying by itself, unless it was refused.
  events.addEventListener('error', () => {
    onTrouble('luxel does not answer; what is shown may be out of date');
    if (events.readyState === EventSource.CLOSED) {
      setTimeout(() => listen(onScene, onTrouble), 2000);
    }
  });
}

// What is asked for has been replaced meanwhile; the next event names what is there now.
export class Overtaken extends Error {}

export async function bytes(address) {
  const answer = await fetch(address);
  if (answer.status === 409) throw new Overtaken();
  if (!answer.ok) throw new Error(`${address.split('?')[0]}: ${(await answer.text()).trim() || answer.status}`);
  return answer.arrayBuffer();
}
