// Wheel base with the line protocol of docs/wheel-protocol.md: it counts two quadrature encoders, drives two motors at
// commanded speeds, and sends its counts 50 times per second.
//
// Wiring and dimensions are set in the first block; nothing below it has to be changed. For Arduino Mega, Uno (which has
// interrupts on pins 2 and 3 only) or ESP32, and motor drivers with one PWM and one direction pin per motor.

// ---- robot --------------------------------------------------------------------------------------------------------

const uint8_t LEFT_A = 2, LEFT_B = 4;    // encoder channels; A needs an interrupt
const uint8_t RIGHT_A = 3, RIGHT_B = 5;
const uint8_t LEFT_PWM = 9, LEFT_DIRECTION = 7;
const uint8_t RIGHT_PWM = 10, RIGHT_DIRECTION = 8;
const bool LEFT_REVERSED = false, RIGHT_REVERSED = true;  // such that both count and drive forwards

const float COUNTS_PER_METRE = 5000.0;  // both edges of channel A are counted
const float TRACK = 0.30;               // metres between the wheels
const float FULL_SPEED = 0.6;           // m/s at full duty, for the feed-forward duty
const float GAIN = 0.8;                 // share of full duty per m/s of error
const float INTEGRAL_GAIN = 4.0;        // share of full duty per m/s of error and second

// ---- protocol -----------------------------------------------------------------------------------------------------

const uint32_t BAUD = 115200;
const uint32_t PERIOD = 20000;          // microseconds between lines
const uint32_t DEADMAN = 500000;        // microseconds from the last command until the wheels stop
const uint8_t MAX_LINE_LENGTH = 80;     // characters

volatile int32_t left_count = 0, right_count = 0;

struct Wheel {
  uint8_t pwm, direction;
  bool reversed;
  float target;        // m/s
  float integral;      // share of full duty
  int32_t last_count;  // in the previous period
};

Wheel left_wheel = {LEFT_PWM, LEFT_DIRECTION, LEFT_REVERSED, 0, 0, 0};
Wheel right_wheel = {RIGHT_PWM, RIGHT_DIRECTION, RIGHT_REVERSED, 0, 0, 0};

uint16_t sequence = 0;
uint32_t next_line = 0, last_command = 0;
char command[MAX_LINE_LENGTH + 1];
uint8_t command_length = 0;
bool overlong = false;

#if defined(ESP32)
#define IN_INTERRUPT IRAM_ATTR
#else
#define IN_INTERRUPT
#endif

void IN_INTERRUPT count_left() {
  bool forwards = digitalRead(LEFT_A) != digitalRead(LEFT_B);
  left_count += forwards != LEFT_REVERSED ? 1 : -1;
}

void IN_INTERRUPT count_right() {
  bool forwards = digitalRead(RIGHT_A) != digitalRead(RIGHT_B);
  right_count += forwards != RIGHT_REVERSED ? 1 : -1;
}

void setup() {
  Serial.begin(BAUD);
  const uint8_t inputs[] = {LEFT_A, LEFT_B, RIGHT_A, RIGHT_B};
  for (uint8_t i = 0; i < 4; i++) pinMode(inputs[i], INPUT_PULLUP);
  const uint8_t outputs[] = {LEFT_PWM, LEFT_DIRECTION, RIGHT_PWM, RIGHT_DIRECTION};
  for (uint8_t i = 0; i < 4; i++) pinMode(outputs[i], OUTPUT);
  attachInterrupt(digitalPinToInterrupt(LEFT_A), count_left, CHANGE);
  attachInterrupt(digitalPinToInterrupt(RIGHT_A), count_right, CHANGE);
  next_line = micros();
}

void loop() {
  read_commands();
  uint32_t now = micros();
  if ((int32_t)(now - next_line) < 0) return;
  next_line += PERIOD;
  if ((int32_t)(now - next_line) >= 0) next_line = now + PERIOD;  // delayed by more than a period

  noInterrupts();  // both counts at the same time and consistent
  uint32_t time = micros();
  int32_t left = left_count, right = right_count;
  interrupts();

  send_reading(time, left, right);
  if (now - last_command > DEADMAN) left_wheel.target = right_wheel.target = 0;
  control(left_wheel, left);
  control(right_wheel, right);
}

// Send one reading. A base with a gyro appends its heading: see docs/wheel-protocol.md.
void send_reading(uint32_t time, int32_t left, int32_t right) {
  char line[MAX_LINE_LENGTH];
  snprintf(line, sizeof line, "O,%u,%lu,%ld,%ld", (unsigned)sequence++, (unsigned long)time, (long)left, (long)right);
  char end[5];
  snprintf(end, sizeof end, "*%02X\n", checksum(line, strlen(line)));
  Serial.print(line);
  Serial.print(end);
}

uint8_t checksum(const char *text, uint8_t length) {
  uint8_t sum = 0;
  for (uint8_t i = 0; i < length; i++) sum ^= (uint8_t)text[i];
  return sum;
}

void read_commands() {
  while (Serial.available() > 0) {
    char c = (char)Serial.read();
    if (c == '\n') {
      command[command_length] = 0;
      if (!overlong) execute_command();
      command_length = 0;
      overlong = false;
    } else if (command_length < MAX_LINE_LENGTH) {
      command[command_length++] = c;
    } else {
      overlong = true;
    }
  }
}

// Execute a command V,<mm/s>,<millirad/s>*HH; incomplete or damaged ones are ignored.
void execute_command() {
  if (command_length < 7 || command[command_length - 3] != '*') return;
  char expected[3];
  snprintf(expected, sizeof expected, "%02X", checksum(command, command_length - 3));
  if (strcmp(expected, command + command_length - 2) != 0) return;
  command[command_length - 3] = 0;
  long speed, turn_rate;
  char extra;
  if (sscanf(command, "V,%ld,%ld%c", &speed, &turn_rate, &extra) != 2) return;
  float half = turn_rate / 1000.0 * TRACK / 2;
  left_wheel.target = speed / 1000.0 - half;
  right_wheel.target = speed / 1000.0 + half;
  last_command = micros();
}

// Feed-forward from the target, plus proportional and integral control of the measured speed.
void control(Wheel &wheel, int32_t count) {
  const float seconds = PERIOD / 1e6;
  float speed = (count - wheel.last_count) / COUNTS_PER_METRE / seconds;
  wheel.last_count = count;
  if (wheel.target == 0) {
    wheel.integral = 0;
    set_duty(wheel, 0);
    return;
  }
  float error = wheel.target - speed;
  wheel.integral = constrain(wheel.integral + INTEGRAL_GAIN * error * seconds, -0.5f, 0.5f);
  set_duty(wheel, wheel.target / FULL_SPEED + GAIN * error + wheel.integral);
}

void set_duty(Wheel &wheel, float duty) {
  duty = constrain(duty, -1.0f, 1.0f);
  digitalWrite(wheel.direction, (duty < 0) != wheel.reversed ? HIGH : LOW);
  analogWrite(wheel.pwm, (int)(255 * fabs(duty)));
}
