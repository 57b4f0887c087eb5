// SPDX-License-Identifier: MIT
// A host at a serial line as the master of an AXI bus, one request at a time:
//
//   request  operation ("R" or "W") | byte address (4) | words (2) | data (4 a word, "W") | checksum (4)
//   answer   data (4 a word, "R") | response (1) | checksum (4)
//
// All numbers come lowest byte first; a word has 32 bits and a checksum is the CRC-32 of all that
// stands before it. The response is the worst of the bus's. A request whose checksum or operation is
// wrong is not answered, but the words of a "W" have been written by then. A break on the line ends
// whatever goes on; the next byte begins a request.
module pearl_uart_bridge #(
    parameter int unsigned CLOCKS_PER_BIT = 15
) (
    input  logic clk_i,
    input  logic rst_ni,
    input  logic rx_i,
    output logic tx_o,

    // Bursts of one word each: a word takes hundreds of cycles on the line.
    output logic [31:0] m_axi_awaddr,
    output logic [ 7:0] m_axi_awlen,
    output logic [ 2:0] m_axi_awsize,
    output logic [ 1:0] m_axi_awburst,
    output logic        m_axi_awvalid,
    input  logic        m_axi_awready,
    output logic [31:0] m_axi_wdata,
    output logic [ 3:0] m_axi_wstrb,
    output logic        m_axi_wlast,
    output logic        m_axi_wvalid,
    input  logic        m_axi_wready,
    input  logic [ 1:0] m_axi_bresp,
    input  logic        m_axi_bvalid,
    output logic        m_axi_bready,
    output logic [31:0] m_axi_araddr,
    output logic [ 7:0] m_axi_arlen,
    output logic [ 2:0] m_axi_arsize,
    output logic [ 1:0] m_axi_arburst,
    output logic        m_axi_arvalid,
    input  logic        m_axi_arready,
    input  logic [31:0] m_axi_rdata,
    input  logic [ 1:0] m_axi_rresp,
    input  logic        m_axi_rvalid,
    output logic        m_axi_rready
);

  localparam logic [7:0] READ = "R";
  localparam logic [7:0] WRITE = "W";
  // CRC-32 of IEEE 802.3, and what it makes of anything with its own checksum behind it.
  localparam logic [31:0] POLYNOMIAL = 32'hEDB8_8320;
  localparam logic [31:0] RESIDUE = 32'hDEBB_20E3;

  function automatic logic [31:0] crc_of(logic [31:0] crc, logic [7:0] data);
    logic [31:0] result = crc ^ 32'(data);
    for (int i = 0; i < 8; i++) result = (result >> 1) ^ (result[0] ? POLYNOMIAL : '0);
    return result;
  endfunction

  typedef struct packed {
    logic [15:0] words;
    logic [31:0] address;
  } request_t;

  typedef enum logic [2:0] {
    Header,
    // A word from the host, and onto the bus.
    Data,
    Write,
    // The request's checksum.
    Check,
    // A word from the bus, and to the host.
    Read,
    Send,
    // Response and checksum.
    Tail
  } state_e;

  // Bytes of each, less one.
  localparam logic [2:0] LAST_OF_HEADER = 3'd6;
  localparam logic [2:0] LAST_OF_WORD = 3'd3;
  localparam logic [2:0] LAST_OF_TAIL = 3'd4;

  state_e state_q;
  logic [2:0] count_q;
  // The last bytes of the header, or what is left to do.
  request_t request_d, request_q;
  logic [7:0] operation;
  logic [31:0] word_d, word_q, crc_q, rx_crc;
  logic [1:0] resp_q;
  // Not yet taken by the bus.
  logic aw_q, w_q, ar_q;

  logic rx_valid, rx_break, tx_valid, tx_ready, sent;
  logic [7:0] rx_data, tx_data;

  pearl_uart_rx #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_rx (
      .clk_i,
      .rst_ni,
      .rx_i,
      .valid_o(rx_valid),
      .data_o (rx_data),
      .break_o(rx_break)
  );

  pearl_uart_tx #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_tx (
      .clk_i,
      .rst_ni,
      .valid_i(tx_valid),
      .data_i (tx_data),
      .ready_o(tx_ready),
      .tx_o
  );

  // When the last byte of a header comes, its first is the next to go.
  assign request_d = request_t'({rx_data, request_q[$bits(request_t)-1:8]});
  assign operation = request_q[7:0];
  assign word_d = {rx_data, word_q[31:8]};
  assign rx_crc = crc_of(crc_q, rx_data);

  always_comb begin
    tx_valid = state_q == Send || state_q == Tail;
    tx_data  = word_q[7:0];
    if (state_q == Tail) tx_data = count_q == '0 ? 8'(resp_q) : ~crc_q[7:0];
  end
  assign sent = tx_valid && tx_ready;

  // The state after what there may be no more words of.
  function automatic state_e words_left(logic [15:0] words, state_e more, state_e none);
    return words == '0 ? none : more;
  endfunction

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q           <= Header;
      count_q           <= '0;
      request_q         <= '0;
      word_q            <= '0;
      crc_q             <= '1;
      resp_q            <= '0;
      {aw_q, w_q, ar_q} <= '0;
    end else begin
      unique case (state_q)
        Header:
        if (rx_valid) begin
          request_q <= request_d;
          crc_q     <= rx_crc;
          count_q   <= count_q + 1'b1;
          if (count_q == LAST_OF_HEADER) begin
            count_q <= '0;
            resp_q  <= '0;
            if (operation == WRITE) state_q <= words_left(request_d.words, Data, Check);
            else if (operation == READ) state_q <= Check;
            else crc_q <= '1;
          end
        end
        Data:
        if (rx_valid) begin
          word_q  <= word_d;
          crc_q   <= rx_crc;
          count_q <= count_q + 1'b1;
          if (count_q == LAST_OF_WORD) begin
            count_q <= '0;
            state_q <= Write;
            {aw_q, w_q} <= '1;
          end
        end
        Write: begin
          if (m_axi_awready) aw_q <= 1'b0;
          if (m_axi_wready) w_q <= 1'b0;
          if (m_axi_bvalid) begin
            if (m_axi_bresp > resp_q) resp_q <= m_axi_bresp;
            request_q.address <= request_q.address + 32'd4;
            request_q.words <= request_q.words - 1'b1;
            state_q <= words_left(request_q.words - 1'b1, Data, Check);
          end
        end
        Check:
        if (rx_valid) begin
          crc_q   <= rx_crc;
          count_q <= count_q + 1'b1;
          if (count_q == LAST_OF_WORD) begin
            count_q <= '0;
            crc_q   <= '1;
            ar_q    <= rx_crc == RESIDUE && request_q.words != '0;
            state_q <= rx_crc == RESIDUE ? words_left(request_q.words, Read, Tail) : Header;
          end
        end
        Read: begin
          if (m_axi_arready) ar_q <= 1'b0;
          if (m_axi_rvalid) begin
            if (m_axi_rresp > resp_q) resp_q <= m_axi_rresp;
            word_q <= m_axi_rdata;
            request_q.address <= request_q.address + 32'd4;
            request_q.words <= request_q.words - 1'b1;
            state_q <= Send;
          end
        end
        Send:
        if (sent) begin
          word_q  <= word_q >> 8;
          crc_q   <= crc_of(crc_q, tx_data);
          count_q <= count_q + 1'b1;
          if (count_q == LAST_OF_WORD) begin
            count_q <= '0;
            ar_q    <= request_q.words != '0;
            state_q <= words_left(request_q.words, Read, Tail);
          end
        end
        Tail:
        if (sent) begin
          crc_q   <= count_q == '0 ? crc_of(crc_q, tx_data) : crc_q >> 8;
          count_q <= count_q + 1'b1;
          if (count_q == LAST_OF_TAIL) begin
            count_q <= '0;
            crc_q   <= '1;
            state_q <= Header;
          end
        end
        default: state_q <= Header;
      endcase
      // A break is much longer than a word takes on the bus, which has to end as it should.
      if (rx_break && !(state_q inside {Write, Read})) begin
        state_q <= Header;
        count_q <= '0;
        crc_q   <= '1;
      end
    end
  end

  assign m_axi_awaddr  = {request_q.address[31:2], 2'b00};
  assign m_axi_awlen   = '0;
  assign m_axi_awsize  = 3'd2;
  assign m_axi_awburst = 2'b01;
  assign m_axi_awvalid = aw_q;
  assign m_axi_wdata   = word_q;
  assign m_axi_wstrb   = '1;
  assign m_axi_wlast   = 1'b1;
  assign m_axi_wvalid  = w_q;
  assign m_axi_bready  = state_q == Write;
  assign m_axi_araddr  = m_axi_awaddr;
  assign m_axi_arlen   = '0;
  assign m_axi_arsize  = 3'd2;
  assign m_axi_arburst = 2'b01;
  assign m_axi_arvalid = ar_q;
  assign m_axi_rready  = state_q == Read;

endmodule
