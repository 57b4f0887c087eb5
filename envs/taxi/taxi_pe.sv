// The core of Taxi: step.py in hardware. Pipelined, a slot a cycle.

// verilator lint_off DECLFILENAME
package taxi_pkg;
  // verilator lint_on DECLFILENAME

  localparam int unsigned LATENCY = 5;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 12;
  localparam int unsigned ACTION_BITS = 3;
  localparam int unsigned OBS_BITS = 9;
  localparam int unsigned REWARD_BITS = 2;

  typedef struct packed {
    // The passenger will yet change his mind.
    logic fickle;
    logic [1:0] destination;
    // At one of the four stands, or aboard.
    logic [2:0] passenger;
    logic [2:0] column;
    logic [2:0] row;
  } state_t;

endpackage

module taxi_pe
  import taxi_pkg::*;
#(
    // 1 if steps take a draw: in rain, and where passengers may be fickle.
    parameter int unsigned STEP_DRAWS = 0,
    parameter bit IS_RAINY = 1'b0,
    // In rain a taxi drives on where the draw times 3, modulo 2**32, is below the first of these,
    // slips to the left where it is below the second, and to the right otherwise.
    parameter logic [31:0] FORWARD_BELOW = 32'hcccccccd,
    parameter logic [31:0] LEFT_BELOW = 32'he6666666,
    // A passenger is fickle where the rest of the start's draw is below this.
    parameter logic [31:0] FICKLE_BELOW = 32'h0
) (
    input logic                        clk_i,
    input logic                        rst_ni,
    input logic                        valid_i,
    // Start from an initial state, not from state_i.
    input logic                        first_i,
    // Do not step: the result is the state started from and its observation.
    input logic                        hold_i,
    input state_t                      state_i,
    input logic   [         2:0]       action_i,
    // The random draws of this slot and step, the one for the initial state first.
    input logic   [STEP_DRAWS:0][31:0] rng_i,

    output logic         valid_o,
    output state_t       state_o,
    output logic   [8:0] obs_o,
    // 0 for a step, 1 for serving nobody, 2 for a passenger delivered.
    output logic   [1:0] reward_o,
    output logic         terminated_o
);

  localparam logic [2:0] SOUTH = 3'd0;
  localparam logic [2:0] NORTH = 3'd1;
  localparam logic [2:0] EAST = 3'd2;
  localparam logic [2:0] WEST = 3'd3;
  localparam logic [2:0] PICKUP = 3'd4;
  localparam logic [2:0] DROPOFF = 3'd5;
  localparam logic [2:0] LAST = 3'd4;
  localparam logic [2:0] ABOARD = 3'd4;

  typedef struct packed {
    logic [2:0] action;
    // Where the taxi goes if the way is free, and which other stand a passenger may think of.
    logic [2:0] direction;
    logic [1:0] third;
    logic       hold;
  } order_t;

  // The k-th of the three stands that are not the given one.
  function automatic logic [1:0] other(logic [1:0] k, logic [1:0] stand);
    return k + {1'b0, k >= stand};
  endfunction

  // First and second stage: the digits of a start, from the products of one draw as in the golden
  // function, two of its multiplications at a time; and the way that rain leaves to the action.
  logic [36:0] cell_product_d, cell_product_q;
  logic [35:0] stands_product_d, stands_product_q;
  logic [4:0] cell_q;
  order_t [2:0] order_q;
  order_t order_d;
  state_t [1:0] state_q;
  logic [1:0] first_q;

  assign cell_product_d = {5'b0, rng_i[0]} * 37'd25;
  assign stands_product_d = {4'b0, cell_product_q[31:0]} * 36'd12;
  assign order_d.action = action_i;
  assign order_d.hold = hold_i;

  if (STEP_DRAWS != 0) begin : gen_drawn
    logic [33:0] tripled;
    logic slips, to_right;
    assign tripled = {2'b00, rng_i[STEP_DRAWS]} + {1'b0, rng_i[STEP_DRAWS], 1'b0};
    assign slips = IS_RAINY & tripled[31:0] >= FORWARD_BELOW & !action_i[2];
    assign to_right = tripled[31:0] >= LEFT_BELOW;
    assign order_d.third = tripled[33:32];
    // Of a direction's two bits the upper one is the axis: a slip changes it.
    assign order_d.direction = {
      action_i[2], action_i[1] ^ slips, slips ? action_i[1] ^ action_i[0] ^ to_right : action_i[0]
    };
  end else begin : gen_not_drawn
    assign order_d.third = '0;
    assign order_d.direction = action_i;
  end

  always_ff @(posedge clk_i) begin
    cell_product_q <= cell_product_d;
    stands_product_q <= stands_product_d;
    cell_q <= cell_product_q[36:32];
    order_q <= {order_q[1:0], order_d};
    state_q <= {state_q[0], state_i};
    first_q <= {first_q[0], first_i};
  end

  // Third stage: where the slot starts from.
  state_t start, from_q;
  logic [3:0] stands;
  logic is_fickle;

  assign stands = stands_product_q[35:32];
  if (FICKLE_BELOW != 0) begin : gen_fickle
    assign is_fickle = stands_product_q[31:0] < FICKLE_BELOW;
  end else begin : gen_steadfast
    logic unused_rest;
    assign unused_rest = ^stands_product_q[31:0];
    assign is_fickle   = 1'b0;
  end
  always_comb begin
    start.row = {2'b0, cell_q >= 5'd5} + {2'b0, cell_q >= 5'd10} + {2'b0, cell_q >= 5'd15} + {2'b0, cell_q >= 5'd20};
    start.column = 3'(cell_q - {start.row, 2'b00} - {2'b00, start.row});
    start.passenger = {2'b0, stands >= 4'd3} + {2'b0, stands >= 4'd6} + {2'b0, stands >= 4'd9};
    start.destination =
        other(2'(stands - {start.passenger[1:0], 1'b0} - {1'b0, start.passenger}), start.passenger[1:0]);
    start.fickle = is_fickle;
  end

  always_ff @(posedge clk_i) from_q <= first_q[1] ? start : state_q[1];

  // Fourth stage: driving and serving.
  state_t moved_d, moved_q;
  logic [1:0] reward_q;
  logic terminated_q;
  logic upper, lower, odd, south, north, east, west, free, down, up, right, left;
  logic red, green, yellow, blue, at_stand, picks_up, drops_off, delivered, illegal, changes;
  logic [1:0] stand;

  order_t order;
  assign order = order_q[2];

  // Walls are east of column 1 in the upper two rows, and of columns 0 and 2 in the lower two.
  assign upper = from_q.row < 3'd2;
  assign lower = from_q.row > 3'd2;
  assign odd = from_q.column[0];
  assign south = from_q.row < LAST;
  assign north = from_q.row != '0;
  assign east = from_q.column < LAST & !(upper & from_q.column == 3'd1) & !(lower & !odd);
  assign west = from_q.column != '0 & !(upper & from_q.column == 3'd2) & !(lower & odd);
  assign free = !order.hold & (
      (order.action == SOUTH & south) | (order.action == NORTH & north) |
      (order.action == EAST & east) | (order.action == WEST & west));
  assign down = free & order.direction == SOUTH & south;
  assign up = free & order.direction == NORTH & north;
  assign right = free & order.direction == EAST & east;
  assign left = free & order.direction == WEST & west;

  assign red = from_q.row == '0 & from_q.column == '0;
  assign green = from_q.row == '0 & from_q.column == 3'd4;
  assign yellow = from_q.row == LAST & from_q.column == '0;
  assign blue = from_q.row == LAST & from_q.column == 3'd3;
  assign at_stand = red | green | yellow | blue;
  assign stand = {yellow | blue, green | blue};
  assign picks_up = !order.hold & order.action == PICKUP & at_stand & from_q.passenger == {1'b0, stand};
  assign drops_off = !order.hold & order.action == DROPOFF & at_stand & from_q.passenger == ABOARD;
  assign delivered = drops_off & stand == from_q.destination;
  assign illegal = order.action[2] & !picks_up & !drops_off;

  assign changes = from_q.fickle & from_q.passenger == ABOARD & (down | up | right | left);

  always_comb begin
    moved_d = from_q;
    moved_d.row = from_q.row + {2'b00, down} - {2'b00, up};
    moved_d.column = from_q.column + {2'b00, right} - {2'b00, left};
    if (picks_up) moved_d.passenger = ABOARD;
    if (drops_off) moved_d.passenger = {1'b0, stand};
    if (STEP_DRAWS != 0 && changes) begin
      moved_d.destination = other(order.third, from_q.destination);
      moved_d.fickle = 1'b0;
    end
  end

  always_ff @(posedge clk_i) begin
    moved_q <= moved_d;
    reward_q <= {delivered, illegal};
    terminated_q <= delivered;
  end

  // Fifth stage: the observation, ((row * 5 + column) * 5 + passenger) * 4 + destination.
  logic [5:0] town_cell;
  logic [6:0] place;
  assign town_cell = {1'b0, moved_q.row, 2'b00} + {3'b000, moved_q.row} + {3'b000, moved_q.column};
  assign place = {town_cell[4:0], 2'b00} + {1'b0, town_cell} + {4'b0000, moved_q.passenger};

  always_ff @(posedge clk_i) begin
    state_o <= moved_q;
    obs_o <= {place, moved_q.destination};
    reward_o <= reward_q;
    terminated_o <= terminated_q;
  end

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end
  assign valid_o = valid_q[LATENCY-1];

endmodule
