// What the server tells, and the files that it tells of.

// Listens to the server until the page is closed. `onScene` gets each scene that is new or has changed; `onAll` the
// numbers of all scenes there are, when the server is heard for the first time or again; `onTrouble` a text when it is
// not heard, and null when it is.
export function listen({ onScene, onAll, onTrouble }) {
  const events = new EventSource('/events');
  // Of a connection that has just begun, until all is told.
  let told = null;
  events.addEventListener('open', () => { told = new Set(); });
  events.addEventListener('scene', (event) => {
    const scene = JSON.parse(event.data);
    told?.add(scene.scene);
    onScene(scene);
  });
  events.addEventListener('told', () => {
    if (told) onAll(told);
    told = null;
    onTrouble(null);
  });
  // The browser goes on trying by itself, unless it was refused.
  events.addEventListener('error', () => {
    onTrouble('luxel does not answer; what is shown may be out of date');
    if (events.readyState === EventSource.CLOSED) {
      setTimeout(() => listen({ onScene, onAll, onTrouble }), 2000);
    }
  });
}

// What is asked for has been replaced meanwhile; the next event names what is there now.
export class Overtaken extends Error {}

// What is asked for has more texels than the server decodes.
export class TooLarge extends Error {}

export async function bytes(address) {
  const answer = await fetch(address);
  if (answer.status === 409) throw new Overtaken();
  if (answer.status === 501) throw new TooLarge();
  if (!answer.ok) throw new Error(`${address.split('?')[0]}: ${(await answer.text()).trim() || answer.status}`);
  return answer.arrayBuffer();
}
